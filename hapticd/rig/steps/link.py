"""Is the link good enough to feel through? Ten seconds of frames while the device is disabled.

What the ticks of a servo without force tell:

    d          from a sample to the force that was in effect when the next one was latched, by the
               board's clock; its spread, of 99 % of the ticks, is jitter of the loop
    age        of a frame when it is read: frames that wait in a queue are old
    frames     missing, damaged (CRC, short), of zero length, out of sequence, queued: counters
    drift      of the board's clock against the host's: slope of board time over host time. The host
               reads its clock when it wakes, so the residuals are its jitter, which is no white
               noise: ten slopes, each without one block, give the interval (Student's t)

Medians of d and age are of ticks that differ by jitter alone; their interval is between the order
statistics that a binomial with p = 1/2 leaves out with 5 %, and half a microsecond more, for they
come in whole ones.

Then the board's watchdog is tried (`watchdog`).

What would break it: somebody who uses the device meanwhile (it is asked to be disabled).
"""

from collections.abc import Iterator, Mapping
from math import sqrt
from typing import Any

import numpy as np

from hapticd.client.blocks import Records
from hapticd.client.client import Client
from hapticd.core.arrays import Floats
from hapticd.core.errors import AnalysisError, CommandError
from hapticd.core.units import NS_PER_US, US_PER_S
from hapticd.protocol.answers import Status
from hapticd.rig.records import collect
from hapticd.rig.result import UPPER_END, Finding, StepResult, Value, Verdict
from hapticd.rig.steps import watchdog
from hapticd.signal.verdict import student_quantile
from hapticd.usb.frames import Capability

__all__ = ["measure"]

SECONDS = 10.0
BLOCKS = 10
LEAST_TICKS = 100  # for any of it
MOST_DELAY = 1.0  # periods: above it stability suffers more than a faster rate would bring
MOST_SPREAD = 0.05  # of a period
MOST_DRIFT_PPM = 200.0  # beyond any crystal
ROUNDED = 0.5  # to whole microseconds
RARE = 1e-3  # share of ticks that may go wrong before it is felt
# what a board lacks, and what is lost by it
WITHOUT = {
    Capability.PROBE: "perturbation and impedance need a DAQ of your own",
    Capability.INTERVAL_MEAN: "pairs are instants: their skew is corrected, but not for free",
    Capability.TEMPERATURE: "nobody sees the winding overheat: keep limits.force_n low",
    Capability.EMERGENCY_STOP: "a pressed stop is not told: the servo finds out by missing force",
    Capability.AMPLIFIER_READY: "an amplifier that is off looks like a motor without authority",
    Capability.SAMPLE_PHASE: "the delay cannot be made as short as the bus allows",
}
USEFUL = {
    Capability.INDEX: "the origin is found at a stop or by hand",
    Capability.RESISTANCE: "damping and force get weaker as the winding warms up",
    Capability.EVENT: "no event code of an EEG or eye tracker comes into the recording",
}
REMEDIES = {
    "missing_in": "look at cable and hub, and at what else shares the bus",
    "bad_in": "a damaged or short frame: look at cable and shield, and at the firmware's CRC",
    "empty_in": "the firmware sends packets of zero length: send IN only when it is whole",
    "stale_in": "frames come twice: the firmware has to send each sample once",
    "behind_in": "frames wait in a queue: give the endpoint one buffer, the newest replaces",
    "sequence_gap": "samples are skipped between board and host: look at the bus and its hub",
    "write_errors": "OUT frames are not taken: look at the bus and the firmware's OUT endpoint",
    "lost_slots": "the host misses ticks: `hapticd doctor`",
}


def measure(bench: Client, seconds: float = SECONDS) -> StepResult:
    """Listen for `seconds`, then try the watchdog; no force is made. CommandError unless
    disabled.
    """
    require_disabled(bench)
    servo = bench.hello().servo
    before = bench.status()
    stretch = collect(bench, seconds)
    after = bench.status()
    period_us = US_PER_S / float(servo["realtime"]["rate_hz"])
    report = after.servo
    watched = watchdog.measure(bench, report.get("board", {}))
    values = (*_values(stretch.records, after), *watched.values)
    counted = _counted(before, after)
    findings = [
        *_timing(values, period_us),
        *_frames(counted, len(stretch.records)),
        *_features(report),
        *watched.findings,
    ]
    if stretch.lost:
        findings.append(
            Finding(f"{stretch.lost} ticks lost by telemetry", "warning", "repeat on a calm host")
        )
    arrays = {
        name: np.asarray(stretch.records[name])
        for name in ("tick", "time_ns", "board_us", "delay_us", "frame_age_us", "arrival", "flags")
    }
    silences = np.array([(one.seconds, one.tripped) for one in watched.silences])
    return StepResult("link", values, findings, arrays=arrays | {"silences": silences})


def require_disabled(bench: Client) -> None:
    """CommandError unless the servo is disabled."""
    state = bench.status().state
    if state != "disabled":
        raise CommandError(
            "refused", f"the servo is {state}, a step begins from disabled; `hapticd disable`"
        )


def require_force(status: Status) -> None:
    """AnalysisError with the cause if the servo of `status` is not enabled any more."""
    if status.state != "enabled":
        raise force_ended(status)


def force_ended(status: Status) -> AnalysisError:
    """The error for a step whose force has ended, with the cause that `status` names."""
    cause = f": {status.cause}" if status.cause else ""
    remedy = f"; {status.remedy}" if status.remedy else ""
    return AnalysisError(
        f"force ended meanwhile (the servo is {status.state}{cause}){remedy}; then repeat the step"
    )


def require_verified(servo: Mapping[str, Any], what: str) -> None:
    """AnalysisError that says `what` while the signs of the device of the hello's `servo` are not
    verified.
    """
    if servo["device"]["commissioning"]:
        raise AnalysisError(
            f"{what} once the signs are verified: `hapticd rig motor` without masses, then start"
            " the daemon again"
        )


def _values(records: Records, status: Status) -> Iterator[Value]:
    delays = records["delay_us"][records["delay_us"] >= 0].astype(np.float64)
    ages = records["frame_age_us"][records["frame_age_us"] >= 0].astype(np.float64)
    for name, found in (("delay", delays), ("frame age", ages)):
        if len(found) >= LEAST_TICKS:
            yield median_of(name, found, "us")
    if len(delays) >= LEAST_TICKS:
        spread_us = float(np.ptp(np.quantile(delays, (0.005, 0.995))))
        yield Value("delay spread", spread_us, "us", spread_us, spread_us)
    if len(records) >= BLOCKS * LEAST_TICKS:
        yield drift_of(records["time_ns"], records["board_us"])
    transport = status.servo.get("transport")
    if transport:
        pair_us = float(transport["pair_us"])
        yield Value("round trip", pair_us, "us", pair_us, pair_us)


def median_of(name: str, found: Floats, unit: str) -> Value:
    """The median of whole numbers `found` (n,), between order statistics (95 %)."""
    ordered = np.sort(found)
    half = 0.98 * sqrt(len(ordered))  # 1.96 times the deviation of a binomial with p = 1/2
    low = max(0, int(np.floor(0.5 * len(ordered) - half)))
    high = min(len(ordered) - 1, int(np.ceil(0.5 * len(ordered) + half)))
    ends = (float(ordered[low]) - ROUNDED, float(ordered[high]) + ROUNDED)
    return Value(name, float(np.median(ordered)), unit, *ends)


def drift_of(time_ns: Any, board_us: Any) -> Value:
    """Drift [ppm] of the board's clock: `board_us` (n,) over `time_ns` (n,)."""
    host_us = (np.asarray(time_ns, np.int64) - int(time_ns[0])) / NS_PER_US
    ahead_us = np.asarray(board_us, np.int64) - int(board_us[0]) - host_us
    blocks = np.array_split(np.arange(len(host_us)), BLOCKS)
    left = [slope_of(np.delete(host_us, one), np.delete(ahead_us, one)) for one in blocks]
    whole = slope_of(host_us, ahead_us)
    deviation = sqrt(BLOCKS - 1) * float(np.std(left))
    half = student_quantile(UPPER_END, BLOCKS - 1) * deviation
    ppm = 1e6
    return Value("clock drift", whole * ppm, "ppm", (whole - half) * ppm, (whole + half) * ppm)


def slope_of(x: Floats, y: Floats) -> float:
    """Slope of the line of least squares through (n,) points."""
    away = x - x.mean()
    return float(away @ y / (away @ away))


def _counted(before: Status, after: Status) -> dict[str, int]:
    old = before.counters
    return {name: count - old.get(name, 0) for name, count in after.counters.items()}


def _timing(values: tuple[Value, ...], period_us: float) -> Iterator[Finding]:
    known = {one.name: one for one in values}
    if "delay" not in known:
        yield Finding("no frame came", "refused", "look at `hapticd status`: is a board there?")
        return
    delay = known["delay"].value / period_us
    late = delay > MOST_DELAY
    yield Finding(
        f"sample to force {delay:.3g} periods",
        "warning" if late else "ok",
        "a bus of its own, or a lower realtime.rate_hz" if late else "",
    )
    spread = known["delay spread"].value / period_us
    wide = spread > MOST_SPREAD
    yield Finding(
        f"it varies by {spread:.3g} periods",
        "warning" if wide else "ok",
        "the board latches IN by the host's OUT: quiet the host (`hapticd doctor`)" if wide else "",
    )
    if drift := known.get("clock drift"):
        fast = min(abs(drift.low), abs(drift.high)) > MOST_DRIFT_PPM
        yield Finding(
            f"board's clock {drift.value:.3g} ppm off the host's",
            "warning" if fast else "ok",
            "more than a crystal: is it the RC oscillator, or a wrong prescaler?" if fast else "",
        )


def _frames(counted: Mapping[str, int], ticks: int) -> Iterator[Finding]:
    if not counted:
        yield Finding("counters of frames", "not done", "this daemon tells none")
        return
    for name, remedy in REMEDIES.items():
        count = counted.get(name, 0)
        often = count > RARE * ticks
        verdict: Verdict = "refused" if often else "warning" if count else "ok"
        yield Finding(f"{name}: {count} in {ticks} ticks", verdict, remedy if count else "")


def _features(report: Mapping[str, Any]) -> Iterator[Finding]:
    """What the servo's `report` says of the board, and what this board cannot do."""
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
