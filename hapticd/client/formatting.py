"""Receipts, verdicts and events as text, and the warning about an unsafe environment.

Text (`receipt_text`, `event_words`). Terminal and page have the same wording. The imports of this
module must be small, because `hapticd --help` loads it. An event of an unknown kind is shown as its
fields.

Warning (`GuardWarnings`). There is one `GuardWarning` for each environment that is or will be in
force although its verdict is not safe.

Limitations: with a filter that turns warnings into errors, the change has acted before the error is
raised. With `Client(strict=True)` no unsafe change acts.
"""

import json
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from hapticd.core.environment import FIELDS, flat
from hapticd.core.errors import GuardWarning
from hapticd.mailbox.layout import VALUE_LIMITS, Value
from hapticd.protocol.answers import (
    Event,
    GuardStatus,
    GuardVerdict,
    LateTicks,
    Receipt,
    Timing,
    TimingCost,
)
from hapticd.protocol.journal import Explanation
from hapticd.protocol.limits import PLACES

if TYPE_CHECKING:
    from hapticd.client.sequence import StepReceipt
    from hapticd.core.errors import CommandError

__all__ = [
    "board_words",
    "event_words",
    "faults_off",
    "guard_line",
    "known_words",
    "late_words",
    "margin_words",
    "objection_lines",
    "parameters",
    "receipt_text",
    "refusal_lines",
    "timing_words",
    "verdict_lines",
]


def verdict_lines(verdict: GuardVerdict | None) -> list[str]:
    """Return the ranges that a verdict allows, as text; an empty list without a verdict."""
    if verdict is None:
        return []
    lines = []
    allowed = verdict.allowed
    units = {"K": "N/m", "B": "N s/m", "M": "kg"}
    ranges = [
        f"{name} {ends[0]:.4g} to {ends[1]:.4g} {units[name]}"
        for name, ends in allowed.items()
        if ends
    ]
    if ranges:
        lines.append(f"allowed, each with the others as asked: {', '.join(ranges)}")
    elif allowed:
        lines.append("no K, B or M alone is enough, with the others as asked")
    least = verdict.least_active_damping_ns_per_m
    if least is not None:
        lines.append(f"least level of active damping tried that is enough: {least:.4g} N s/m")
    elif allowed and verdict.safe is False:
        lines.append("no active damping of this device is enough")
    return lines


def objection_lines(verdict: GuardVerdict, more: Iterable[str] = ()) -> list[str]:
    """Return the reasons why a change is not safe, one a line: the problem, the allowed ranges and
    `more`, then the rest and the remedies.
    """
    why = Explanation(verdict.reasons, verdict.remedies)
    return why.lines(verdict.outcome, [*verdict_lines(verdict), *more])


def refusal_lines(error: "CommandError", more: Iterable[str] = ()) -> list[str]:
    """Return the same for a refusal by the guard, after the command; otherwise the message."""
    verdict = error.guard
    if verdict is None or not verdict.reasons:
        return [str(error), *(verdict_lines(verdict)), *more]
    first, *rest = objection_lines(verdict, more)
    return [f"{verdict.cmd}: {first}" if verdict.cmd else first, *rest]


def guard_line(found: GuardStatus) -> str:
    """Return policy, basis, mode and worker in one line, as `status` shows them."""
    margin = found.margin_ns_per_m
    wanted = f", at least {margin:g} N s/m to spare" if margin else ""
    policy = "off: a measurement is running" if found.measuring else found.policy
    worker = "" if found.worker == "up" else f"; {found.trouble}"
    delay = found.delay_periods
    known = "the delay is not known yet" if delay is None else f"delay {delay:g} periods"
    return f"{policy}, by {found.basis}{wanted}; active damping {found.mode}; {known}{worker}"


def timing_words(timing: Timing | None) -> str:
    """Return the cost of the delay in K (theorem), in one line; empty if it is unknown."""
    if timing is None:
        return ""
    without = timing.without_active_damping
    damped = timing.with_active_damping
    delay = f"delay {timing.delay_periods:g} periods, {known_words(timing.measured)}"
    if without.lost_share is None:
        return f"{delay}: no K is passive, with or without it (theorem)"
    lost = f"K up to {_instead(without)} N/m without it ({100.0 * without.lost_share:.0f} % less)"
    if damped.level_ns_per_m:
        lost += f"; with {damped.level_ns_per_m:g} N s/m of active damping {_instead(damped)}"
    return f"{delay}: {lost} (theorem)"


def known_words(measured: bool) -> str:
    """Return the origin of a delay."""
    return "measured" if measured else "assumed by the model"


def _instead(cost: TimingCost) -> str:
    return f"{cost.stiffness_n_per_m:.4g} instead of {cost.ideal_stiffness_n_per_m:.4g}"


def late_words(late: Mapping[str, LateTicks]) -> str:
    """Return late ticks by cause, in one line; empty if there are none."""
    return ", ".join(
        f"{found.count} {name} (latest {found.latest_us:.0f} us)"
        for name, found in late.items()
        if found.count
    )


def margin_words(found: GuardStatus) -> str:
    """Return the verdict on the environment in force, in one line."""
    known = found.verdict.text if found.verdict else ""
    return known or found.unjudged or "not judged yet"


_FAULT_OFF = {
    "no_overspeed": "off: the device file gives no overspeed_m_per_s",
    "no_physical_damping": "off: the device file gives no physical_damping_ns_per_m",
    "measuring": "off: while measuring is leased",
    "off": "off: as asked, until force is off again or as configured",
}


def faults_off(found: Mapping[str, str]) -> list[str]:
    """Return a line for each limit-cycle fault that is off, with the reason."""
    return [f"{name} {_FAULT_OFF.get(why, why)}" for name, why in found.items() if why != "on"]


def board_words(report: dict[str, Any]) -> str:
    """Return the reason why the servo waits for its board; empty when the board answers."""
    reason = report.get("waiting_for", "")
    return f"the servo waits for the board: {reason}" if reason else ""


def receipt_text(receipt: Receipt) -> str:
    """Return the result of a change, and the values that will then be in force."""
    if receipt.result == "pressed":
        return "stop requested, but not confirmed; see `hapticd status`"
    stages = receipt.guard.stages if receipt.guard else 0
    result = f"stage 1 of {stages}" if receipt.result == "staged" and stages else receipt.result
    when = f"{result} at tick {receipt.first_tick}"
    if receipt.ramp_end_tick > receipt.first_tick:
        when += f", ramp ends at tick {receipt.ramp_end_tick}"
    shown = _shown(receipt.effective)
    if receipt.result == "staged" and receipt.guard:
        shown += f"; on the way to {_shown(receipt.guard.given)}"
    return f"{receipt.state}: {when}, revision {receipt.revision}: {shown}{_margin(receipt.guard)}"


def _shown(table: dict[str, Any]) -> str:
    """Return K, B, M and active damping of parameters in the shape of a `set`."""
    values = dict(parameters(table))
    names = {one.key: one.symbol for one in FIELDS if one.symbol}
    names["active_damping"] = "active damping"
    return ", ".join(f"{names[name]} {values[name]}" for name in names if name in values)


def _margin(verdict: GuardVerdict | None) -> str:
    """Return the margin of an environment that is known to be safe."""
    if not verdict or not verdict.safe:
        return ""
    how = "reduced to a safe value, " if verdict.clamped else ""
    margin = verdict.margin_ns_per_m
    spare = "" if margin is None else f"{margin:.3g} N s/m to spare, "
    return f"; {how}{spare}by {verdict.basis}"


def parameters(table: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield (dotted name, value with unit) of parameters in the shape of a `set`."""
    for name, value in flat(table):
        place = PLACES.get(name.replace("active_damping_level", "active_damping"))
        unit = VALUE_LIMITS[place].unit if place is not None else ""
        # a level is rounded to a count of the board's converter: 1.73999 was requested as 1.74
        shown = f"{value:.4g}" if place == Value.ACTIVE_DAMPING else f"{value:.6g}"
        yield name, shown if unit in ("", "1", "side") else f"{shown} {unit}"


# --- events ---------------------------------------------------------------------------------------
_HIDDEN = {"timestamp", "kind", "code", "actor", "id", "number", "epoch"}
_WHOLE = ("state", "servo_up", "servo_down", "gap", "flight")  # whose text needs no kind before it


def event_words(event: Event) -> str:
    """Return an event as text: action, object and author, without its time."""
    if event.kind == "answer":
        return f"{event.cmd} of {event.name}: {event.text or event.result}"
    if event.kind == "mark":
        return f"mark: {event.text} (by {event.name}, tick {event.tick})"
    if not event.text:
        return _plain(event)
    return event.text if event.kind in _WHOLE else f"{event.kind}: {event.text}"


def _plain(event: Event) -> str:
    usual = asdict(Event())
    given = {name: value for name, value in asdict(event).items() if value != usual[name]}
    shown = [f"{name} {value}" for name, value in given.items() if name not in _HIDDEN]
    return f"{event.kind}: {', '.join(shown)}"


# --- the warning ----------------------------------------------------------------------------------
DONE = ("applied", "scheduled", "staged")  # results of a change that acts, or will
FALLBACK = "ask for less of K, B and M"  # if the verdict has no sufficient value


class GuardWarnings:
    """Warns of unsafe changes that act, once for each environment."""

    def __init__(self) -> None:
        self._warned: set[str] = set()

    def tell(self, *receipts: "Receipt | StepReceipt") -> None:
        """Emit a GuardWarning for each of `receipts` that has not had one."""
        for receipt in receipts:
            verdict = receipt.guard
            if verdict is None or verdict.safe is not False or receipt.result not in DONE:
                continue
            environment = json.dumps(verdict.given, sort_keys=True)
            if environment not in self._warned:
                self._warned.add(environment)
                warnings.warn(_warning(verdict, receipt), stacklevel=_levels_to_caller())

    def tell_beside(self, receipts: "Iterable[StepReceipt]") -> None:
        """Warn while another error is raised, without replacing it."""
        for receipt in receipts:
            with suppress(GuardWarning):
                self.tell(receipt)


def _warning(verdict: GuardVerdict, receipt: "Receipt | StepReceipt") -> GuardWarning:
    margin = verdict.worse.margin_ns_per_m
    lines = verdict_lines(verdict)
    spare = [] if margin is None else [f"margin {margin:.3g} N s/m"]
    why = Explanation(verdict.reasons, verdict.remedies)
    parts = why.lines("", [*spare, *lines])
    text = f"{receipt.result}, and not safe: {'; '.join(parts)}"
    return GuardWarning(text, margin, "; ".join(lines) or FALLBACK, receipt)


def _levels_to_caller() -> int:
    """Return the `stacklevel` for the calling function, so that a warning refers to the line of the
    script.
    """
    level = 1
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals["__name__"].startswith("hapticd.client"):
        frame = frame.f_back
        level += 1
    return level
