"""Explain a verdict: its plain map, reasons and remedies, and the destabilising hand.

Each sentence must have value, unit and remedy. A `safe` verdict must include the list NOT_COVERED.
"""

from collections.abc import Sequence
from math import log
from typing import Any

from hapticd.core.environment import Environment
from hapticd.core.params import GuardSetup
from hapticd.guard.bases import Reading, cached_levels
from hapticd.guard.safe_region import SafeRegion
from hapticd.model.coupled import Hand
from hapticd.protocol.explanation import Explanation, Outcome, Reason, Remedy, because

NOT_COVERED = ("contact switching", "varying delay")
NOTHING_KNOWN: dict[str, Any] = {
    "basis": "unknown",
    **Reading(None, None, None)._asdict(),
    "contact": None,
    "delay_periods": None,
    "allowed": {},
    "least_active_damping_ns_per_m": None,
}


class VerdictBuilder:
    """Verdicts on environments of the device of `setup`, as plain maps (docs/guard.md).

    `levels`: the cached levels of active damping, N s/m.
    """

    def __init__(self, setup: GuardSetup) -> None:
        self.setup = setup
        self.levels = cached_levels(
            setup.active_damping_limit_ns_per_m, setup.active_damping_ns_per_m
        )

    def of(
        self,
        region: SafeRegion | None,
        environment: Environment,
        policy: str,
        outcome: Outcome,
        why: Explanation,
        path: Sequence[Environment],
        given: Environment,
    ) -> dict[str, Any]:
        """Return the verdict on `environment`, judged along `path`; `given` is the end of the
        stages.
        """
        known = NOTHING_KNOWN if region is None else self._known(region, environment)
        if region is not None and known["least_active_damping_ns_per_m"] is None:
            no_level = (one for one in why.remedies if one.code != Remedy.MORE_DAMPING)
            why = Explanation(why.reasons, tuple(no_level))
        ends = self.setup.environment.workspace.stiffness_n_per_m > 0.0
        return {
            "safe": None if region is None else outcome is Outcome.SAFE,
            "policy": policy,
            **known,
            "clamped": outcome is Outcome.CLAMPED,
            "given": given.message(),
            "path_points": sum(len(one.points()) for one in path),
            "not_covered": [*NOT_COVERED, "soft ends of the workspace"] if ends else [*NOT_COVERED],
            **why.plain(outcome),
        }

    def _known(self, region: SafeRegion, environment: Environment) -> dict[str, Any]:
        contact = region.in_contact(environment)
        return {
            "basis": region.basis.name,
            **region.reading(environment)._asdict(),
            "contact": None if contact is None else contact._asdict(),
            "delay_periods": region.delays_periods[0],
            "allowed": region.allowed(environment, self.setup.limits),
            "least_active_damping_ns_per_m": region.least_level(environment, self.levels),
        }


def explain(region: SafeRegion, environment: Environment, safe: bool, way: str = "") -> Explanation:
    """Explain the safety of an environment, with values, units and, if it is unsafe, remedies.
    `way` is a prefix of the description of the environment.
    """
    where = f"{way}{environment_text(environment)}"
    if environment.stiffness_n_per_m < 0.0:
        text = f"{where}: K < 0 pushes away and is active at low frequencies"
        negative = because(Reason.NEGATIVE_STIFFNESS, text)
        return negative.and_remedy(Remedy.POSITIVE_STIFFNESS, "ask for K >= 0")
    worst = region.worse(environment)
    side = "" if worst == region.reading(environment) else " in the wall"
    if worst.margin_ns_per_m is None:
        limits = f"the limits of {region.basis.name}"
        if safe:
            return because(Reason.INSIDE, f"{where}: inside {limits}")
        outside = because(Reason.OUTSIDE, f"{where}: not inside {limits}")
        return outside.and_remedy(Remedy.LESS, "ask for less")
    if safe:
        spare = (
            f"{worst.margin_ns_per_m:.3g} N s/m to spare{side}, least at {worst.worst_hz:.3g} Hz"
        )
        return because(Reason.SPARE, f"{where}: {spare}")
    code, text = _shortage(region, worst, side)
    short = because(code, f"{where}: {text}").and_remedy(Remedy.LESS, "ask for less")
    return short.and_remedy(Remedy.MORE_DAMPING, "for more active damping")


def _shortage(region: SafeRegion, worst: Reading, side: str) -> tuple[Reason, str]:
    margin = worst.margin_ns_per_m or 0.0
    rate_hz = region.basis.rate_hz
    if worst.radius is not None and worst.radius >= 1.0 and rate_hz is not None:
        return Reason.UNSTABLE, (
            f"unstable without a hand{side}, its motion {doubling_text(worst.radius, rate_hz)},"
            f" worst near {worst.worst_hz:.3g} Hz"
        )
    return Reason.SHORT, (
        f"{region.spare_ns_per_m - margin:.3g} N s/m short{side} at {worst.worst_hz:.3g} Hz"
        f" ({region.basis.name})"
    )


def doubling_text(radius: float, rate_hz: float) -> str:
    """Return the growth of a motion that each tick multiplies by `radius` >= 1: `doubles
    in 40 ms`.
    """
    if radius <= 1.0:
        return "does not die out"
    seconds = log(2.0) / (log(radius) * rate_hz)
    return f"doubles in {1e3 * seconds:.3g} ms" if seconds < 1.0 else f"doubles in {seconds:.3g} s"


def environment_text(environment: Environment) -> str:
    """Describe an environment by its numbers."""
    k, b, m = environment.free
    level = environment.active_damping_ns_per_m
    return f"K = {k:g} N/m, B = {b:g} N s/m, M = {m:g} kg with {level:.4g} N s/m of active damping"


def hand_text(hand: Hand, hz: float, in_wall: bool) -> dict[str, Any]:
    """Describe a hand as its mass, or as its spring to the ground. Small tuned masses, which serve
    the spectral images of sampling, are left out.
    """
    where = f"at {hz:.3g} Hz" + (", in the wall" if in_wall else "")
    mass_kg = float(hand.mass_kg[0])
    if mass_kg > 0.0:
        return {"text": f"a mass of {1e3 * mass_kg:.3g} g, {where}", "mass_kg": mass_kg}
    # the sum of row 0 removes the joints to the other nodes and leaves the spring to the ground
    stiffness = float(hand.stiffness_n_per_m[0].sum())
    return {"text": f"a spring of {stiffness:.0f} N/m, {where}", "stiffness_n_per_m": stiffness}
