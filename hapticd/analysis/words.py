"""What a judgement says in words: one sentence about a display, and the hand that shakes it."""

from typing import Any

from hapticd.analysis.allowed import Judgement, Reading
from hapticd.analysis.coupled import Hand
from hapticd.analysis.displays import Display


def sentence(judgement: Judgement, display: Display, safe: bool) -> str:
    """What is known of a display, with values, units and, if it is not safe, a remedy."""
    where = named(display)
    if display.stiffness_n_per_m < 0.0:
        return f"{where}: K < 0 pushes away and is active at low frequencies; ask for K >= 0"
    worst = judgement.worse(display)
    side = "" if worst == judgement.reading(display) else " in the wall"
    if worst.margin_ns_per_m is None:
        kind = "inside" if safe else "not inside"
        remedy = "" if safe else "; ask for less"
        return f"{where}: {kind} the limits of {judgement.basis.name}{remedy}"
    if safe:
        return (
            f"{where}: {worst.margin_ns_per_m:.3g} N s/m to spare{side}, least at"
            f" {worst.worst_hz:.3g} Hz"
        )
    return f"{where}: {_shortage(judgement, worst, side)}; ask for less, or for more damping"


def _shortage(judgement: Judgement, worst: Reading, side: str) -> str:
    margin = worst.margin_ns_per_m or 0.0
    if worst.radius is not None and worst.radius >= 1.0:
        return (
            f"unstable by itself{side}, each tick times {worst.radius:.5g}, worst near"
            f" {worst.worst_hz:.3g} Hz"
        )
    return (
        f"{judgement.spare_ns_per_m - margin:.3g} N s/m short{side} at {worst.worst_hz:.3g} Hz"
        f" ({judgement.basis.name})"
    )


def named(display: Display) -> str:
    """A display by its numbers."""
    return (
        f"K = {display.stiffness_n_per_m:g} N/m, B = {display.damping_ns_per_m:g} N s/m,"
        f" M = {1e3 * display.mass_kg:g} g with {display.added_ns_per_m:g} N s/m of damping"
    )


def in_words(hand: Hand, hz: float, in_wall: bool) -> dict[str, Any]:
    """A hand as one thing that can be imagined: its mass, or its spring to the ground; small tuned
    masses beside it, which serve images, are left out.
    """
    where = f"at {hz:.3g} Hz" + (", in the wall" if in_wall else "")
    mass_kg = float(hand.mass_kg[0])
    if mass_kg > 0.0:
        return {"text": f"a mass of {1e3 * mass_kg:.3g} g, {where}", "mass_kg": mass_kg}
    # what is left at node 0 once the joints to the other nodes are taken away
    stiffness = float(hand.stiffness_n_per_m[0].sum())
    return {"text": f"a spring of {stiffness:.0f} N/m, {where}", "stiffness_n_per_m": stiffness}
