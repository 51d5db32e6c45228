"""Compare the sensor of the winding's temperature with a thermometer.

A winding that was off for half an hour has the temperature of the room, which the operator states.
Its sensor has to agree approximately, without drift, and not be at the end of its converter. Then
the count at 0 degC follows from it, with the scale that the file has from a data sheet
(SCALE_HALF). With a second, stated temperature the scale itself is measured,

    c = (T2 - T1) / (n2 - n1),   offset = n1 - T1 / c

and both have the thermometer's tolerance. Drift is a line over the seconds at rest, with blocks for
its interval, as noise of a sensor is rarely white.

The back-EMF is measured in the same step, while a hand shakes the handle (`winding`).

Limitations: a winding that is still warm from earlier use (the drift shows it), or a thermometer in
another place than the sensor.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot, sqrt
from typing import Any

import numpy as np

from hapticd.client.client import Client
from hapticd.core.arrays import Floats
from hapticd.core.errors import AnalysisError
from hapticd.core.params import ScaleParams
from hapticd.rig.estimate import deviation, line
from hapticd.rig.experiment import begin_step, collect
from hapticd.rig.hand import Ask, Request
from hapticd.rig.result import (
    FACTOR,
    Change,
    Finding,
    StepResult,
    Value,
    change_of,
    checked,
    settled,
)
from hapticd.rig.steps.winding import analyse_back_emf, raw_counts
from hapticd.usb.codec import I16_HIGHEST, I16_LOWEST

__all__ = ["KnownTemperatures", "measure"]

REST_S = 10.0
SHAKE_S = 6.0
BLOCKS = 10
SCALE_HALF = 0.02  # relative, of a scale from a data sheet
MOST_OFF_C = 5.0  # plausible offset between sensor and statement
FAR_OFF_C = 25.0  # beyond which it is not an offset
LEAST_APART_C = 5.0  # of two temperatures
LEAST_COUNTS = 5.0  # between two temperatures
MOST_DRIFT_C_PER_MIN = 1.0


@dataclass(frozen=True)
class KnownTemperatures:
    """Temperatures of a thermometer at the winding: of the room, and optionally when it is warm."""

    celsius: tuple[float, ...]
    tolerance_c: float = 0.5  # half of the 95 % interval of each


def measure(
    bench: Client, ask: Ask, stated: KnownTemperatures, with_shake: bool = True
) -> StepResult:
    """Read the sensor at each temperature, then the back-EMF while a hand shakes the handle.

    CommandError unless disabled; AnalysisError for a board without the sensor, or temperatures that
    are too close.
    """
    servo = begin_step(bench)
    _refuse(stated)
    device = servo["device"]
    room_c = stated.celsius[0]
    ask(Request("let go", f"let go; the winding has to be as warm as the room, {room_c:g} degC"))
    readings = [_read(bench, device)]
    for warm_c in stated.celsius[1:]:
        ask(Request("warm", f"warm the winding to {warm_c:g} degC and hold it there", warm_c))
        readings.append(_read(bench, device))
    at_rest = analyse(np.array(readings), stated, device)
    if not with_shake or not at_rest.settled:  # a refused result needs no shaken handle
        return at_rest
    text = f"from now on, for {SHAKE_S:g} s: move the handle back and forth quickly by a few mm"
    ask(Request("shake", text, SHAKE_S))
    return at_rest + analyse_back_emf(collect(bench, SHAKE_S).records, device)


def _refuse(stated: KnownTemperatures) -> None:
    if len(stated.celsius) not in (1, 2):
        raise AnalysisError(f"{len(stated.celsius)} temperatures: state one, or two")
    apart_c = float(np.ptp(stated.celsius))
    if len(stated.celsius) == 2 and apart_c < LEAST_APART_C:
        raise AnalysisError(
            f"the temperatures are {apart_c:g} K apart; take {LEAST_APART_C:g} K or more"
        )


def _read(bench: Client, device: Mapping[str, Any]) -> Floats:
    winding_c = collect(bench, REST_S).records["winding_c"].astype(np.float64)
    if not np.isfinite(winding_c).all():
        raise AnalysisError(
            "this board measures no temperature: leave `temperature` out of relies_on in its device"
            " file"
        )
    return raw_counts(winding_c, device["temperature"])


def analyse(readings: Floats, stated: KnownTemperatures, device: Mapping[str, Any]) -> StepResult:
    """Evaluate counts (k, n) of the sensor at k temperatures, over REST_S each, with the scales of
    the hello's `device`.
    """
    scale = device["temperature"]
    per_count = float(scale["per_count"])
    drift = drift_of(readings[-1], per_count)
    steady = checked(
        f"it drifts by {drift.value:.2g} K/min",
        max(abs(drift.low), abs(drift.high)) <= MOST_DRIFT_C_PER_MIN,
        "wait until the winding has the temperature of its surroundings",
    )
    findings = [_living(readings), steady]
    values = [deviation("temperature noise", per_count * readings[-1], "K rms"), drift]
    changes: list[Change] = []
    if settled(findings):
        scales = scale_of(readings, stated, scale)
        values += scales
        findings.append(_plausible(readings, stated, scale, scales))
        changes = [
            Change("temperature", "sign", _sign(readings, stated, scale)),
            *map(change_of, scales),
        ]
    arrays = {"readings": readings, "stated_c": np.array(stated.celsius)}
    return StepResult("temperature", values, findings, changes, arrays)


def _living(readings: Floats) -> Finding:
    means = readings.mean(axis=1)
    what = f"the sensor reads {', '.join(f'{mean:.1f}' for mean in means)} counts"
    if means.min() <= I16_LOWEST + 1 or means.max() >= I16_HIGHEST - 1:
        remedy = "the end of its converter range: the sensor is open or shorted; check its wires"
        return Finding(what, "refused", remedy)
    follows = len(means) != 2 or abs(means[1] - means[0]) >= LEAST_COUNTS
    return checked(what, follows, "stuck sensor: it does not follow the temperature", "refused")


def drift_of(counts: Floats, per_count: float) -> Value:
    """Return the slope of `counts` (n,) over REST_S, in K/min: of the means of ten blocks."""
    away = counts - counts[0]  # a constant sensor then has no rounding error in its mean
    means = away[: len(counts) // BLOCKS * BLOCKS].reshape(BLOCKS, -1).mean(axis=1)
    at_min = (np.arange(BLOCKS) + 0.5 - BLOCKS / 2) * REST_S / BLOCKS / 60.0
    return line(at_min, per_count * means).value(0, "temperature drift", "K/min")


def scale_of(readings: Floats, stated: KnownTemperatures, scale: Mapping[str, Any]) -> list[Value]:
    """Return the offset, and with two temperatures also the scale, from counts (k, n)."""
    counts = readings.mean(axis=1)
    celsius = np.array(stated.celsius)
    scales: list[Value] = []
    if len(celsius) == 1:
        per_count = int(scale["sign"]) * float(scale["per_count"])
        unsure_c = hypot(stated.tolerance_c, SCALE_HALF * celsius[0])
    else:
        apart_c = abs(float(celsius[1] - celsius[0]))
        per_count = float((celsius[1] - celsius[0]) / (counts[1] - counts[0]))
        half = abs(per_count) * sqrt(2.0) * stated.tolerance_c / apart_c
        scales = [Value.around("temperature.c_per_count", abs(per_count), "K", half)]
        # 0 degC lies outside both: their errors are extrapolated to it
        unsure_c = stated.tolerance_c * hypot(*celsius) / apart_c
    offset = float(counts[0] - celsius[0] / per_count)
    half = unsure_c / abs(per_count)
    return [*scales, Value.around("temperature.offset_count", offset, "counts", half)]


def _plausible(
    readings: Floats, stated: KnownTemperatures, scale: Mapping[str, Any], scales: Sequence[Value]
) -> Finding:
    told_c = ScaleParams(**scale).to_value(float(readings[0].mean()))
    away_c = told_c - stated.celsius[0]
    what = f"by the device file it is {told_c:.1f} degC where {stated.celsius[0]:g} degC are stated"
    slopes = [one.value for one in scales if one.name == "temperature.c_per_count"]
    ratio = slopes[0] / float(scale["per_count"]) if slopes else 1.0
    if not 1.0 / FACTOR <= ratio <= FACTOR:
        return Finding(
            f"a count is {ratio:.3g} of the value in the device file",
            "refused",
            "check that both are in degC and those of the sensor; if so, correct the file",
        )
    if abs(away_c) > FAR_OFF_C and not slopes:
        return Finding(
            what, "refused", "check the type of sensor and its scale, or enter two temperatures"
        )
    return checked(
        what, abs(away_c) <= MOST_OFF_C, "the device file gets the count that means 0 degC"
    )


def _sign(readings: Floats, stated: KnownTemperatures, scale: Mapping[str, Any]) -> int:
    """Return the sign of the file, or that of the counts between two temperatures."""
    if len(stated.celsius) != 2:
        return int(scale["sign"])
    return 1 if np.diff(readings.mean(axis=1))[0] * np.diff(stated.celsius)[0] > 0.0 else -1
