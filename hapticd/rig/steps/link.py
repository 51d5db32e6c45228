"""Test the link: ten seconds of frames while the device is disabled, then the board's watchdog.

The ticks of a servo without force give:

    d          from a sample to the force that was in effect when the next one was latched, by the
               board's clock; its spread, of 99 % of the ticks, is jitter of the loop
    age        of a frame when it is read: frames that wait in a queue are old
    frames     missing, damaged (CRC, short), of zero length, out of sequence, queued: counters
    drift      of the board's clock against the host's: slope of board time over host time. The host
               reads its clock when it wakes, so the residuals are its jitter, which is not white
               noise: ten slopes, each without one block, give the interval (Student's t)

Medians of d and age are of ticks that differ by jitter alone. Their interval lies between the order
statistics that a binomial with p = 1/2 excludes with 5 %, plus half a microsecond, for they are
whole microseconds.

Then the board's watchdog is tried. The disabled servo withholds frames for a time and requests
authority over zero force. A board that has tripped reports this in its answer, with the damping
that it holds. The first silence is well beyond the time stated in the hello. If the board trips,
the interval is halved until a silence of one period more trips it and one less does not. The time
is between the two, by the board's own clock. A board that did not trip is not tried again.

Damping of COUNTS converter counts, which is imperceptible, is on during the trial, so that there is
a level to hold. Whether it tripped, and the level held, are only reported by the board, and the
torque was 0 throughout: the end of a force is not observed. The finding and the certificate state
this.

The device must not be used during the step (it has to be disabled). A host that is late by periods
after a silence only needs more silences: the times are those of the board's clock.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from hapticd.client.client import Client
from hapticd.core.arrays import Floats, Records
from hapticd.core.errors import AnalysisError
from hapticd.core.units import NS_PER_US, US_PER_S
from hapticd.mailbox.layout import LONGEST_SILENCE_S, Flag
from hapticd.protocol.answers import Status
from hapticd.rig.experiment import begin_step, collect, servo_rate_hz
from hapticd.rig.result import (
    NORMAL,
    Finding,
    StepResult,
    Value,
    Verdict,
    checked,
    in_blocks,
    jackknife,
)
from hapticd.usb.frames import Capability, StatusBit

__all__ = ["measure"]

MS_PER_S = 1000

SECONDS = 10.0
BLOCKS = 10
LEAST_TICKS = 100  # for any of the values
MOST_DELAY = 1.0  # periods: above it stability suffers more than a faster rate would improve it
MOST_SPREAD = 0.05  # of a period
MOST_DRIFT_PPM = 200.0  # beyond any crystal
ROUNDED = 0.5  # to whole microseconds
RARE = 1e-3  # share of bad ticks that remains imperceptible
# features that a board lacks, and the consequence
WITHOUT = {
    Capability.PROBE: "perturbation and impedance need a DAQ of your own",
    Capability.INTERVAL_MEAN: "pairs are instants: their skew is corrected, but not for free",
    Capability.TEMPERATURE: "an overheated winding stays unnoticed: keep limits.force_n low",
    Capability.EMERGENCY_STOP: "a pressed stop is inferred from missing force, not reported",
    Capability.AMPLIFIER_READY: "an amplifier that is off looks like a motor without authority",
    Capability.SAMPLE_PHASE: "the delay cannot be made as short as the bus allows",
}
USEFUL = {
    Capability.INDEX: "the origin is found at a stop or by hand",
    Capability.RESISTANCE: "damping and force get weaker as the winding warms up",
    Capability.EVENT: "no event code of an EEG or eye tracker comes into the recording",
}
REMEDIES = {
    "missing_in": "check cable, hub and the other devices on the bus",
    "bad_in": "a damaged or short frame: check cable, shield and the firmware's CRC",
    "empty_in": "the firmware sends packets of zero length: send IN only when it is whole",
    "stale_in": "frames come twice: the firmware has to send each sample once",
    "behind_in": "frames wait in a queue: give the endpoint one buffer, the newest replaces",
    "sequence_gap": "samples are lost between board and host: check the bus and its hub",
    "write_errors": "OUT frames are not accepted: check the bus and the firmware's OUT endpoint",
    "lost_slots": "the host misses ticks: `hapticd doctor`",
}
RECORDED = ("tick", "time_ns", "board_us", "delay_us", "frame_age_us", "arrival", "flags")
COUNTS = 16  # of active damping: a few thousandths of a N s/m
BEYOND = 1.5  # times the stated time, and
MARGIN_S = 0.01  # added to it: the first silence
AFTER_S = 0.1
MOST_SILENCES = 16
SLOW_MS = 300.0  # duration for which an uncommanded force would act
REMEDY = (
    "do not enable this board: its watchdog has to run from a timer that needs neither USB nor the"
    " main loop"
)


def measure(bench: Client, seconds: float = SECONDS) -> StepResult:
    """Record frames for `seconds`, then try the watchdog, without force. CommandError unless
    disabled.
    """
    servo = begin_step(bench)
    before = bench.status().counters
    span = collect(bench, seconds)
    after = bench.status()
    watched = try_watchdog(bench, after.servo.get("board", {}))
    values = tuple(_values(span.records, after))
    counted = {name: count - before.get(name, 0) for name, count in after.counters.items()}
    findings = [
        *_timing(values, US_PER_S / float(servo["realtime"]["rate_hz"])),
        *_frames(counted, len(span.records)),
        *_features(after.servo),
    ]
    if span.lost:
        findings.append(
            Finding(f"{span.lost} ticks lost by telemetry", "warning", "repeat on a calm host")
        )
    arrays = {name: np.asarray(span.records[name]) for name in RECORDED}
    return StepResult("link", values, findings, arrays=arrays) + watched


def _values(records: Records, status: Status) -> Iterator[Value]:
    known = {name: records[name][records[name] >= 0] for name in ("delay_us", "frame_age_us")}
    for column, found in known.items():
        if len(found) >= LEAST_TICKS:
            name = column.removesuffix("_us").replace("_", " ")
            yield median_of(name, found.astype(np.float64), "us")
    if len(known["delay_us"]) >= LEAST_TICKS:
        spread_us = float(np.ptp(np.quantile(known["delay_us"], (0.005, 0.995))))
        yield Value.around("delay spread", spread_us, "us", 0.0)
    if len(records) >= BLOCKS * LEAST_TICKS:
        yield drift_of(records["time_ns"], records["board_us"])
    if transport := status.servo.get("transport"):
        yield Value.around("round trip", float(transport["pair_us"]), "us", 0.0)


def median_of(name: str, found: Floats, unit: str) -> Value:
    """Return the median of whole numbers `found` (n,), between order statistics (95 %)."""
    ordered = np.sort(found)
    half = 0.5 * NORMAL * np.sqrt(len(ordered))  # standard deviation of a binomial with p = 1/2
    low = max(0, int(np.floor(0.5 * len(ordered) - half)))
    high = min(len(ordered) - 1, int(np.ceil(0.5 * len(ordered) + half)))
    ends = (float(ordered[low]) - ROUNDED, float(ordered[high]) + ROUNDED)
    return Value(name, float(np.median(ordered)), unit, *ends)


def drift_of(time_ns: Any, board_us: Any) -> Value:
    """Return the drift [ppm] of the board's clock: `board_us` (n,) over `time_ns` (n,)."""
    host_us = (np.asarray(time_ns, np.int64) - int(time_ns[0])) / NS_PER_US
    ahead_us = np.asarray(board_us, np.int64) - int(board_us[0]) - host_us
    columns = np.column_stack([host_us, np.ones_like(host_us)])
    fit = jackknife(in_blocks(columns, BLOCKS), in_blocks(ahead_us, BLOCKS))
    return Value.around("clock drift", 1e6 * fit.values[0], "ppm", 1e6 * fit.halves[0])


def _timing(values: tuple[Value, ...], period_us: float) -> Iterator[Finding]:
    known = {one.name: one for one in values}
    if "delay" not in known:
        yield Finding("no frame came", "refused", "see `hapticd status`: is a board connected?")
        return
    delay = known["delay"].value / period_us
    yield checked(
        f"sample to force {delay:.3g} periods",
        delay <= MOST_DELAY,
        "a bus of its own, or a lower realtime.rate_hz",
    )
    spread = known["delay spread"].value / period_us
    yield checked(
        f"it varies by {spread:.3g} periods",
        spread <= MOST_SPREAD,
        "the board latches IN by the host's OUT: quiet the host (`hapticd doctor`)",
    )
    if drift := known.get("clock drift"):
        yield checked(
            f"board's clock {drift.value:.3g} ppm off the host's",
            min(abs(drift.low), abs(drift.high)) <= MOST_DRIFT_PPM,
            "more than a crystal: is it the RC oscillator, or a wrong prescaler?",
        )


def _frames(counted: Mapping[str, int], ticks: int) -> Iterator[Finding]:
    if not counted:
        yield Finding("counters of frames", "not done", "this daemon does not report it")
        return
    for name, remedy in REMEDIES.items():
        count = counted.get(name, 0)
        often = count > RARE * ticks
        verdict: Verdict = "refused" if often else "warning" if count else "ok"
        yield Finding(f"{name}: {count} in {ticks} ticks", verdict, remedy if count else "")


def _features(report: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield differences in the servo's `report` of the board, and features the board lacks."""
    for difference in report.get("differences", ()):
        yield Finding(difference, "refused", "correct the device file or plug in its board")
    if reason := report.get("uncompensated"):
        yield Finding(reason, "warning", "damping and force get weaker as the winding warms up")
    board = report.get("board", {})
    if "capabilities" not in board:
        return
    has = Capability(board["capabilities"])
    for feature, price in WITHOUT.items():
        if not feature & has:
            yield Finding(f"it lacks {feature.name}", "warning", price)
    for feature, price in USEFUL.items():
        if not feature & has:
            yield Finding(f"it has no {feature.name}: {price}", "ok")


class Silence(NamedTuple):
    """Answer of the board after a silence."""

    seconds: float  # between two OUT frames, by its own clock
    tripped: bool
    authority: bool  # it granted torque in the first frame after
    held_ns_per_m: float  # active damping in effect then
    asked_ns_per_m: float  # requested before
    left: bool  # it accepted the next frames normally


def try_watchdog(bench: Client, board: Mapping[str, Any]) -> StepResult:
    """Try the watchdog of a disabled servo's board, whose hello `board` states `watchdog_ms`."""
    stated_s = float(board.get("watchdog_ms", 0)) / MS_PER_S
    first_s = BEYOND * stated_s + MARGIN_S
    if not 0.0 < first_s <= LONGEST_SILENCE_S:
        most_ms = MS_PER_S * (LONGEST_SILENCE_S - MARGIN_S) / BEYOND
        untried = Finding(
            f"watchdog of the board: stated is {MS_PER_S * stated_s:g} ms",
            "warning",
            f"not tried; up to {most_ms:.0f} ms can be, and 20 ms is usual",
        )
        return StepResult("watchdog", findings=[untried], arrays={"silences": np.array([])})
    with some_damping(bench):
        silences = [silence(bench, first_s)]
        if silences[0].tripped and not silences[0].authority:
            silences += list(narrowed(bench, silences[0].seconds))
    return _analyse_silences(silences, stated_s, 1.0 / servo_rate_hz(bench))


def narrowed(bench: Client, tripped_s: float) -> Iterator[Silence]:
    """Yield silences that halve the interval between one that does not trip and one that does."""
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
    """Switch active damping on; on exit, restore the previous state and level."""
    least = COUNTS * bench.hello().servo.device.active_damping.per_count
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
    """Return the board's answer after a silence of about `seconds`. AnalysisError without one."""
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
    return Silence(
        (int(answer["board_us"]) - int(found["board_us"][quiet[-1]])) / US_PER_S,
        bool(status & StatusBit.WATCHDOG),
        bool(status & StatusBit.ENABLED),
        float(answer["active_damping_effect_ns_per_m"]),
        float(answer["active_damping_ns_per_m"]),
        not int(found["status"][after[-1]]) & StatusBit.WATCHDOG,
    )


def _analyse_silences(silences: list[Silence], stated_s: float, period_s: float) -> StepResult:
    """Evaluate `silences`, the longest first, for a watchdog of `stated_s`."""
    arrays = {"silences": np.array([(one.seconds, one.tripped) for one in silences])}
    first = silences[0]
    if not first.tripped:
        what = f"{WATCHDOG}: {MS_PER_S * first.seconds:.4g} ms without frames, and it did not trip"
        return StepResult("watchdog", (), [Finding(what, "refused", REMEDY)], arrays=arrays)
    high_ms = MS_PER_S * min(one.seconds for one in silences if one.tripped)
    calm_s = max((one.seconds for one in silences if not one.tripped), default=period_s)
    low_ms = min(MS_PER_S * calm_s, high_ms)
    value = Value("watchdog", (low_ms + high_ms) / 2, "ms", low_ms, high_ms)
    findings = [_time(value, MS_PER_S * stated_s, MS_PER_S * period_s), *_trip(silences)]
    return StepResult("watchdog", [value], findings, arrays=arrays)


WATCHDOG = "watchdog of the board"
SAID = "as reported by the board; no force was on, so the end of a force was not measured"


def _time(value: Value, stated_ms: float, period_ms: float) -> Finding:
    what = f"{WATCHDOG}: trips after {value.low:.4g} to {value.high:.4g} ms without frames, {SAID}"
    if not value.low - period_ms <= stated_ms <= value.high + period_ms:
        return Finding(what, "warning", f"its hello has {stated_ms:g} ms; correct the firmware")
    return checked(
        what,
        stated_ms <= SLOW_MS,
        "the last force continues this long after a host has died: 20 ms is usual",
    )


def _trip(silences: list[Silence]) -> Iterator[Finding]:
    """Yield findings on the board's behaviour in the silences that tripped it."""
    tripped = [one for one in silences if one.tripped]
    if any(one.authority for one in tripped):
        yield Finding("tripped, it still grants torque", "refused", REMEDY)
    if not all(one.left for one in tripped):
        yield Finding(
            "it stays tripped",
            "refused",
            "an OUT without ENABLE has to clear WATCHDOG; correct the firmware",
        )
    step = max(one.asked_ns_per_m for one in tripped) / COUNTS
    for one in tripped:
        if abs(one.held_ns_per_m - one.asked_ns_per_m) > step:
            yield Finding(
                f"tripped, it damps {one.held_ns_per_m:.4g} N s/m",
                "refused",
                f"{one.asked_ns_per_m:.4g} N s/m was commanded and has to be held for 2 s",
            )
            return
    yield Finding("tripped, it holds the damping", "ok")
