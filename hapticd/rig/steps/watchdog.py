"""Does the board act by itself when its host is silent? Frames are withheld, and it is asked.

The servo, disabled, withholds frames for a time and then asks for authority over no force; a board
that has tripped says so in its answer, and how much damping it holds. The first silence is well
beyond the time that the hello states. If the board tripped, halves of what is left are tried until
a silence of a period more trips it and one less does not: the time lies between the two, by the
board's own clock. A board that did not trip is not asked again.

Damping of COUNTS converter counts is on meanwhile, which nobody feels, so that there is something
to hold; damping that was on stays as it is.

That it tripped, and what it holds, is the board's own word, and the torque was 0 all the time: that
a force ends is not seen here. The finding and the certificate say so.

What would break it: a host that is late by periods when the frames begin again (the silences that
were taken are the board's, so only the number of steps would grow).
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from hapticd.client.client import Client
from hapticd.core.errors import AnalysisError
from hapticd.core.units import MS_PER_S, US_PER_S
from hapticd.mailbox.layout import LONGEST_SILENCE_S, Flag
from hapticd.rig.experiment import collect, servo_rate_hz
from hapticd.rig.result import Finding, StepResult, Value, checked
from hapticd.usb.frames import StatusBit

COUNTS = 16  # of active damping: some thousandths of a N s/m
BEYOND = 1.5  # times the stated time, and
MARGIN_S = 0.01  # more: the first silence
AFTER_S = 0.1
MOST_SILENCES = 16
SLOW_MS = 300.0  # so long a force that nobody commands acts
REMEDY = (
    "do not enable this board: its watchdog has to run from a timer that needs neither USB nor the"
    " main loop"
)


class Silence(NamedTuple):
    """What the board told after one."""

    seconds: float  # between two OUT frames, by its own clock
    tripped: bool
    authority: bool  # it granted torque in that very frame
    held_ns_per_m: float  # active damping in effect then
    asked_ns_per_m: float  # and before
    left: bool  # it took the next frames as ever


def measure(bench: Client, board: Mapping[str, Any]) -> StepResult:
    """Try the watchdog of a disabled servo's board, whose hello `board` states `watchdog_ms`."""
    stated_s = float(board.get("watchdog_ms", 0)) / MS_PER_S
    first_s = BEYOND * stated_s + MARGIN_S
    if not 0.0 < first_s <= LONGEST_SILENCE_S:
        what = f"watchdog of the board: stated is {MS_PER_S * stated_s:g} ms"
        most_ms = MS_PER_S * (LONGEST_SILENCE_S - MARGIN_S) / BEYOND
        remedy = f"not tried; up to {most_ms:.0f} ms can be, and 20 ms is usual"
        return StepResult("watchdog", (), [Finding(what, "warning", remedy)])
    with some_damping(bench):
        silences = [silence(bench, first_s)]
        if silences[0].tripped and not silences[0].authority:
            silences += list(narrowed(bench, silences[0].seconds))
    return analyse(silences, stated_s, 1.0 / servo_rate_hz(bench))


def narrowed(bench: Client, tripped_s: float) -> Iterator[Silence]:
    """Silences that halve the time between one that does not trip and one that does."""
    period_s = 1.0 / servo_rate_hz(bench)
    calm_s = period_s
    for _ in range(MOST_SILENCES):
        if tripped_s - calm_s <= 1.5 * period_s:
            return
        found = silence(bench, (tripped_s + calm_s) / 2.0 - period_s)
        yield found
        if found.tripped:
            tripped_s = min(tripped_s, found.seconds)
        else:
            calm_s = max(calm_s, found.seconds)


@contextmanager
def some_damping(bench: Client) -> Iterator[None]:
    """Active damping on; what is switched on for this is switched off, at its old level."""
    device = bench.hello().servo["device"]
    least = COUNTS * float(device["active_damping"]["per_count"])
    asked = collect(bench, AFTER_S).records["active_damping_asked_ns_per_m"][-1]
    if asked >= least:
        yield
        return
    level = bench.damping("off").effective["active_damping_level"]
    try:
        bench.damping(least)
        collect(bench, AFTER_S)
        yield
    finally:
        if level > 0.0:
            bench.damping(level)
        bench.damping("off")


def silence(bench: Client, seconds: float) -> Silence:
    """What the board tells after a silence of about `seconds`. AnalysisError if nothing."""
    wanted_s = max(seconds, 1.0 / servo_rate_hz(bench))
    found = collect(bench, wanted_s + AFTER_S, lambda: bench.withhold(wanted_s)).records
    quiet = np.flatnonzero(found["flags"] & Flag.WITHHELD)
    after = np.flatnonzero(found["arrival"] >= 0)
    after = after[after > quiet[-1]] if len(quiet) else after[:0]
    if len(after) < 2:
        raise AnalysisError(
            "the board did not answer after a silence; see `hapticd status`, then repeat"
        )
    answer = found[after[0]]
    status = int(answer["status"])
    passed_us = int(answer["board_us"]) - int(found["board_us"][quiet[-1]])
    return Silence(
        passed_us / US_PER_S,
        bool(status & StatusBit.WATCHDOG),
        bool(status & StatusBit.ENABLED),
        float(answer["active_damping_effect_ns_per_m"]),
        float(answer["active_damping_ns_per_m"]),
        not int(found["status"][after[-1]]) & StatusBit.WATCHDOG,
    )


def analyse(silences: list[Silence], stated_s: float, period_s: float) -> StepResult:
    """What `silences`, the longest first, say of a watchdog of `stated_s`."""
    arrays = {"silences": np.array([(one.seconds, one.tripped) for one in silences])}
    first = silences[0]
    if not first.tripped:
        what = f"{_NAME}: {MS_PER_S * first.seconds:.4g} ms without frames, and it did not trip"
        return StepResult("watchdog", (), [Finding(what, "refused", REMEDY)], arrays=arrays)
    high_s = min(one.seconds for one in silences if one.tripped)
    low_s = max((one.seconds for one in silences if not one.tripped), default=period_s)
    low_ms, high_ms = MS_PER_S * min(low_s, high_s), MS_PER_S * high_s
    value = Value("watchdog", (low_ms + high_ms) / 2, "ms", low_ms, high_ms)
    findings = [_time(value, MS_PER_S * stated_s, MS_PER_S * period_s), *_trip(silences)]
    return StepResult("watchdog", [value], findings, arrays=arrays)


_NAME = "watchdog of the board"
_SAID = "as the board says; no force acted, so none was seen to end"


def _time(value: Value, stated_ms: float, period_ms: float) -> Finding:
    what = f"{_NAME}: trips after {value.low:.4g} to {value.high:.4g} ms without frames, {_SAID}"
    if not value.low - period_ms <= stated_ms <= value.high + period_ms:
        return Finding(what, "warning", f"its hello says {stated_ms:g} ms; correct the firmware")
    remedy = "so long the last force acts after a host has died: 20 ms is usual"
    return checked(what, stated_ms <= SLOW_MS, remedy)


def _trip(silences: list[Silence]) -> Iterator[Finding]:
    """What the board did in the silences that tripped it."""
    tripped = [one for one in silences if one.tripped]
    if any(one.authority for one in tripped):
        yield Finding("tripped, it still grants torque", "refused", REMEDY)
    if not all(one.left for one in tripped):
        remedy = "an OUT without ENABLE has to clear WATCHDOG; correct the firmware"
        yield Finding("it stays tripped", "refused", remedy)
    step = max(one.asked_ns_per_m for one in tripped) / COUNTS
    for one in tripped:
        if abs(one.held_ns_per_m - one.asked_ns_per_m) > step:
            what = f"tripped, it damps {one.held_ns_per_m:.4g} N s/m"
            remedy = f"{one.asked_ns_per_m:.4g} N s/m was commanded and has to be held for 2 s"
            yield Finding(what, "refused", remedy)
            return
    yield Finding("tripped, it holds the damping", "ok")
