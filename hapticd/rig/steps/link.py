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
from typing import Any

import numpy as np

from hapticd.client.blocks import Records
from hapticd.client.client import Client
from hapticd.core.arrays import Floats
from hapticd.core.units import NS_PER_US, US_PER_S
from hapticd.protocol.answers import Status
from hapticd.rig.estimate import NORMAL, in_blocks, jackknife
from hapticd.rig.experiment import begin, collect
from hapticd.rig.result import Finding, StepResult, Value, Verdict, checked
from hapticd.rig.steps import watchdog
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
RECORDED = ("tick", "time_ns", "board_us", "delay_us", "frame_age_us", "arrival", "flags")


def measure(bench: Client, seconds: float = SECONDS) -> StepResult:
    """Listen for `seconds`, then try the watchdog; no force is made. CommandError unless
    disabled.
    """
    servo = begin(bench)
    before = bench.status().counters
    span = collect(bench, seconds)
    after = bench.status()
    watched = watchdog.measure(bench, after.servo.get("board", {}))
    values = (*_values(span.records, after), *watched.values)
    counted = {name: count - before.get(name, 0) for name, count in after.counters.items()}
    findings = [
        *_timing(values, US_PER_S / float(servo["realtime"]["rate_hz"])),
        *_frames(counted, len(span.records)),
        *_features(after.servo),
        *watched.findings,
    ]
    if span.lost:
        what = f"{span.lost} ticks lost by telemetry"
        findings.append(Finding(what, "warning", "repeat on a calm host"))
    arrays = {name: np.asarray(span.records[name]) for name in RECORDED}
    arrays["silences"] = watched.arrays.get("silences", np.array([]))
    return StepResult("link", values, findings, arrays=arrays)


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
    """The median of whole numbers `found` (n,), between order statistics (95 %)."""
    ordered = np.sort(found)
    half = 0.5 * NORMAL * np.sqrt(len(ordered))  # deviation of a binomial with p = 1/2
    low = max(0, int(np.floor(0.5 * len(ordered) - half)))
    high = min(len(ordered) - 1, int(np.ceil(0.5 * len(ordered) + half)))
    ends = (float(ordered[low]) - ROUNDED, float(ordered[high]) + ROUNDED)
    return Value(name, float(np.median(ordered)), unit, *ends)


def drift_of(time_ns: Any, board_us: Any) -> Value:
    """Drift [ppm] of the board's clock: `board_us` (n,) over `time_ns` (n,)."""
    host_us = (np.asarray(time_ns, np.int64) - int(time_ns[0])) / NS_PER_US
    ahead_us = np.asarray(board_us, np.int64) - int(board_us[0]) - host_us
    columns = np.column_stack([host_us, np.ones_like(host_us)])
    fit = jackknife(in_blocks(columns, BLOCKS), in_blocks(ahead_us, BLOCKS))
    return Value.around("clock drift", 1e6 * fit.values[0], "ppm", 1e6 * fit.halves[0])


def _timing(values: tuple[Value, ...], period_us: float) -> Iterator[Finding]:
    known = {one.name: one for one in values}
    if "delay" not in known:
        yield Finding("no frame came", "refused", "look at `hapticd status`: is a board there?")
        return
    delay = known["delay"].value / period_us
    remedy = "a bus of its own, or a lower realtime.rate_hz"
    yield checked(f"sample to force {delay:.3g} periods", delay <= MOST_DELAY, remedy)
    spread = known["delay spread"].value / period_us
    remedy = "the board latches IN by the host's OUT: quiet the host (`hapticd doctor`)"
    yield checked(f"it varies by {spread:.3g} periods", spread <= MOST_SPREAD, remedy)
    if drift := known.get("clock drift"):
        what = f"board's clock {drift.value:.3g} ppm off the host's"
        remedy = "more than a crystal: is it the RC oscillator, or a wrong prescaler?"
        yield checked(what, min(abs(drift.low), abs(drift.high)) <= MOST_DRIFT_PPM, remedy)


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
