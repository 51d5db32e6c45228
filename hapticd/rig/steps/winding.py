"""The motor's winding: force per ampere, resistance, back-EMF, and the sensor of its temperature.

Force and resistance (`measure`). The handle is held by hand, at rest, under forces of LEVELS to
either side. The motor's voltage is R i and its force K i: two lines over the commanded forces, with
offsets of the sensors in their intercepts. Moved by hand without force, a winding without current
shows K v. Over windows of WINDOW_S the mean of the voltage and the encoder's displacement
correspond exactly, so no velocity is computed from noise. In SI both K are one number [N/A = V
s/m]; if they differ, the scales of current, voltage, force and position contradict each other.

Back-EMF (`analyse_back_emf`). The same motion gives scale and sign of the channel `emf_velocity`.
The device is disabled, so no current flows and the channel shows velocity alone, for any resistance
compensation. Its counts are fitted by the encoder's velocity, its derivative and a constant. The
derivative gives the delay of the channel in ticks, and the fit is repeated with a velocity of the
same delay, by blocks.

Commanded newtons have the interval of `rig motor`, metres that of `rig encoder`; both are taken
from the device file.

Limitations: a hand that lets the handle slip while it is held (the windows show it). A hand that
shakes it so slowly that the AC coupling of an amplifier has an effect. A winding that warms up by
more than the interval allows: the resistance is that at the mean temperature of the rests, which is
written with it.

Temperature (`measure_temperature`). The sensor is compared with a thermometer. A winding that was
off for half an hour has the temperature of the room, which the operator states. Its sensor has to
agree approximately, without drift, and not be at the end of its converter. Then the count at 0 degC
follows from it, with the scale that the file has from a data sheet (SCALE_HALF). With a second,
stated temperature the scale itself is measured,

    c = (T2 - T1) / (n2 - n1),   offset = n1 - T1 / c

and both have the thermometer's tolerance. Drift is a line over the seconds at rest, with blocks for
its interval, as noise of a sensor is rarely white.

The back-EMF is measured in the same step, while a hand shakes the handle.

Limitations: a winding that is still warm from earlier use (the drift shows it), or a thermometer in
another place than the sensor.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, isfinite, sqrt
from typing import Any

import numpy as np

from hapticd.client.client import Client
from hapticd.core.arrays import Floats, Records
from hapticd.core.errors import AnalysisError
from hapticd.core.params import ScaleParams
from hapticd.core.units import COPPER_PER_K, US_PER_S
from hapticd.rig.experiment import begin_step, collect, pull, servo_rate_hz, under_force
from hapticd.rig.result import (
    FACTOR,
    POSITION_HALF,
    Ask,
    Change,
    Finding,
    Fit,
    Request,
    StepResult,
    Value,
    change_of,
    checked,
    deviation,
    in_blocks,
    jackknife,
    line,
    plausible,
    relative_half,
    settled,
)
from hapticd.rig.steps.coast_down import UNKNOWN
from hapticd.rig.steps.motor import allowed_n
from hapticd.usb.codec import I16_HIGHEST, I16_LOWEST

__all__ = ["KnownTemperatures", "measure", "measure_temperature"]

LEVELS = (0.25, 0.5, 0.75, 1.0)  # of a tenth of the force, to either side
RAMP_S = 0.3
SETTLE_S = 0.5
READ_S = 0.5
SHAKE_S = 5.0
WINDOW_S = 0.02
SLIPPED_M = 1e-3  # of a held handle
LEAST_M_PER_S = 5e-3  # rms of a usable motion
DEAD_COUNTS = 20.0  # minimum span of a live channel
AGREE = 0.05
RESTING = ("force_n", "current_a", "voltage_v", "winding_c")
ROOM_C = 20.0  # assumed for a winding without a temperature sensor
BLOCKS = 10
LEAST_COUNTS = 5.0  # rms of a channel that is not dead
LEAST_COHERENT = 0.9
SMOOTHED_TICKS = 9
RECORDED = ("board_us", "position_m", "emf_velocity_m_per_s")


def measure(bench: Client, ask: Ask, lever_m: float | None = None) -> StepResult:
    """Request a held and a moved handle. CommandError unless disabled; AnalysisError if the signs
    are not verified or the handle slips.
    """
    servo = begin_step(bench, "the winding is measured")
    ask(Request("hold", "hold the handle firmly where it is; it will be pushed gently", 0.0))
    most_n = allowed_n(servo)
    with under_force(bench):
        start_m = float(collect(bench, READ_S).records["position_m"].mean())
        forces = [side * level * most_n for side in (1.0, -1.0) for level in LEVELS]
        rests = np.array([_rest(bench, force, start_m) for force in forces])
    text = f"move the handle back and forth by a few mm for {SHAKE_S:g} s from now"
    ask(Request("shake", text, SHAKE_S))
    shaken = collect(bench, SHAKE_S).records
    ask(Request("let go", "let go of the handle"))
    device = servo["device"]
    found = analyse(rests, windows(shaken, servo_rate_hz(bench)), device, lever_m)
    circuit = analyse_back_emf(shaken, device)
    if found.settled and circuit.settled:
        return found + circuit
    left = [replace(one, verdict="warning") for one in circuit.findings if one.remedy]
    return found + StepResult("motor", findings=left)


def _rest(bench: Client, force_n: float, start_m: float) -> list[float]:
    """Return means of commanded force [N], current [A], voltage [V] and the winding's temperature
    [degC], nan if the board does not measure it.
    """
    pull(bench, force_n, start_m, RAMP_S, SETTLE_S)
    found = collect(bench, READ_S).records
    slipped_m = float(np.ptp(found["position_m"]))
    if slipped_m > SLIPPED_M:
        raise AnalysisError(
            f"the held handle moved by {1e3 * slipped_m:.2g} mm; hold it more firmly, and repeat"
        )
    return [float(found[name].astype(np.float64).mean()) for name in RESTING]


def windows(records: Records, rate_hz: float) -> Floats:
    """Return means over consecutive windows (n, 2): velocity from the encoder [m/s] and voltage
    [V].
    """
    size = max(2, round(WINDOW_S * rate_hz))
    edges = np.arange(0, len(records), size)
    speed = np.diff(records["position_m"].astype(np.float64)[edges]) * rate_hz / size
    voltage = _means(records["voltage_v"].astype(np.float64), size)
    length = min(len(speed), len(voltage))
    return np.column_stack([speed[:length], voltage[:length]])


def _means(values: Floats, size: int) -> Floats:
    """Return means by the trapezium rule from each edge of a window to the next one."""
    middles = (values[1:] + values[:-1]) / 2.0
    whole = len(middles) // size
    return np.asarray(middles[: whole * size].reshape(whole, size).mean(axis=1))


def analyse(
    rests: Floats,
    moved: Floats,
    device: Mapping[str, Any],
    lever_m: float | None = None,
) -> StepResult:
    """Evaluate `rests` (n, 4), force, current, voltage and temperature, and `moved` (m, 2) from
    `windows`, with the scales of `device`.
    """
    arrays = {"rests": rests, "moved": moved}
    findings = list(_alive(rests, moved, device))
    if not settled(findings):
        return StepResult("motor", (), findings, (), arrays)
    newton = relative_half(device["force"], UNKNOWN)
    metre = relative_half(device["position"], UNKNOWN)
    force_n, current_a, voltage_v, winding_c = rests.T
    speed_m_per_s, induced_v = moved.T
    celsius = float(winding_c.mean())
    warmed = COPPER_PER_K * float(np.ptp(winding_c)) / 2.0 if isfinite(celsius) else UNKNOWN
    per_ampere = line(current_a, force_n).value(0, "motor.force_n_per_a", "N/A", newton)
    ohm = line(current_a, voltage_v).value(0, "motor.winding_ohm", "ohm", warmed)
    induced = line(speed_m_per_s, induced_v).value(0, "back-EMF", "V s/m", metre)
    ratio = induced.value / per_ampere.value
    agreement = checked(
        f"back-EMF is {ratio:.3g} of the force per ampere; in SI they are one number",
        abs(ratio - 1.0) <= AGREE,
        "the scales of current, voltage, force or position are wrong: see their data sheets",
    )
    findings += [_signs(per_ampere, ohm, induced), agreement]
    values = [per_ampere, ohm, induced]
    reference_c = round(celsius, 1) if isfinite(celsius) else ROOM_C
    changes = [*map(change_of, values[:2]), Change("motor", "reference_c", reference_c)]
    if lever_m is not None:
        torque = lever_m * per_ampere.value
        values.append(Value.around("torque constant", torque, "N m/A", lever_m * per_ampere.half))
        changes.append(Change("motor", "lever_m", lever_m))
    return StepResult("motor", values, findings, changes, arrays)


def _alive(rests: Floats, moved: Floats, device: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield findings on dead channels, and on a handle that was not moved."""
    for name, values in zip(("current", "voltage"), rests.T[1:], strict=False):
        span = float(np.ptp(values)) / float(device[name]["per_count"])
        if span < DEAD_COUNTS:
            yield Finding(
                f"under force the {name} changes by {span:.2g} counts",
                "refused",
                f"the board does not report the motor's {name}, or its sensor is dead",
            )
    speed = float(moved[:, 0].std())
    if speed < LEAST_M_PER_S:
        yield Finding(
            f"the handle was moved with {1e3 * speed:.2g} mm/s rms",
            "refused",
            "move it faster, back and forth by a few mm",
        )


def _signs(per_ampere: Value, ohm: Value, induced: Value) -> Finding:
    names = {"current": per_ampere, "voltage over current": ohm, "voltage over speed": induced}
    wrong = [name for name, value in names.items() if value.value <= 0.0]
    return checked(
        f"the wrong way: {', '.join(wrong)}"
        if wrong
        else "current and voltage have the signs of the force",
        not wrong,
        "correct the sign of `current` or `voltage` in the device file",
        "refused",
    )


def analyse_back_emf(shaken: Records, device: Mapping[str, Any]) -> StepResult:
    """Evaluate the ticks of a `shaken` handle, with the scales of the hello's `device`."""
    scale = device["emf_velocity"]
    counts = raw_counts(shaken["emf_velocity_m_per_s"].astype(np.float64), scale)
    at_s = shaken["board_us"].astype(np.float64) / US_PER_S
    speed = np.gradient(shaken["position_m"].astype(np.float64), at_s)
    arrays = {name: np.asarray(shaken[name]) for name in RECORDED}
    kernel = np.full(SMOOTHED_TICKS, 1.0 / SMOOTHED_TICKS)
    y, v = (np.convolve(one, kernel, "valid") for one in (counts, speed))
    first = np.linalg.lstsq(_columns(v), y)[0]
    finding = _followed(counts, speed, float(first[0]))
    if finding.verdict == "refused":
        return StepResult("back-EMF", (), [finding], (), arrays)
    fit = _late_fit(y, v, -first[1] / first[0])
    per_speed, _, at_rest = fit.values.tolist()
    per_speed_half, _, at_rest_half = fit.halves.tolist()
    full = I16_HIGHEST / per_speed
    relative = hypot(per_speed_half / per_speed, relative_half(device["position"], POSITION_HALF))
    name = "emf_velocity.full_scale_m_per_s"
    values = [
        Value.around(name, abs(full), "m/s", relative * abs(full)),
        # rounding hides the place of a noiseless channel within its count
        Value.around("emf_velocity.offset_count", at_rest, "counts", hypot(at_rest_half, 0.5)),
    ]
    remedy = "correct full_scale_m_per_s in the device file, and repeat"
    findings = [finding, plausible("emf_velocity", 1.0 / per_speed, scale, remedy)]
    sign = Change("emf_velocity", "sign", 1 if full > 0.0 else -1)
    return StepResult("back-EMF", values, findings, [sign, *map(change_of, values)], arrays)


def raw_counts(values: Floats, scale: Mapping[str, Any]) -> Floats:
    """Return the counts (n,) of the readings `values` (n,) by the hello's `scale`."""
    known = ScaleParams(**scale)
    return np.asarray(known.sign * values / known.per_count + known.offset_count)


def _late_fit(counts: Floats, speed: Floats, late_ticks: float) -> Fit:
    """Return counts per m/s, per m/s a tick, and at rest, from `counts` and `speed` (n,) of that
    delay.
    """
    tick = np.arange(len(speed), dtype=np.float64)
    columns = _columns(np.interp(tick - late_ticks, tick, speed))
    return jackknife(in_blocks(columns, BLOCKS), in_blocks(counts, BLOCKS))


def _columns(v: Floats) -> Floats:
    return np.stack([v, np.gradient(v), np.ones_like(v)], axis=1)


def _followed(counts: Floats, speed: Floats, per_speed: float) -> Finding:
    fast = float(speed.std())
    share = float(np.corrcoef(counts, speed)[0, 1] ** 2) if counts.std() > 0.0 else 0.0
    what = (
        f"back-EMF: {1e3 * fast:.3g} mm/s rms at the encoder, {abs(per_speed) * fast:.3g} counts"
        f" follow it, {100 * share:.3g} % of the channel"
    )
    if fast < LEAST_M_PER_S:
        return Finding(what, "refused", "the handle was not shaken: by some mm, and repeat")
    if counts.std() < LEAST_COUNTS:
        return Finding(what, "refused", "dead back-EMF channel: check its amplifier and input")
    return checked(
        what,
        share >= LEAST_COHERENT,
        "it is not a velocity: check the connections and the resistance compensation",
        "refused",
    )


# --- temperature ----------------------------------------------------------------------------------
REST_S = 10.0
SHAKEN_S = 6.0
SCALE_HALF = 0.02  # relative, of a scale from a data sheet
MOST_OFF_C = 5.0  # plausible offset between sensor and statement
FAR_OFF_C = 25.0  # beyond which it is not an offset
LEAST_APART_C = 5.0  # of two temperatures
LEAST_STEP = 5.0  # between two temperatures
MOST_DRIFT_C_PER_MIN = 1.0


@dataclass(frozen=True)
class KnownTemperatures:
    """Temperatures of a thermometer at the winding: of the room, and optionally when it is warm."""

    celsius: tuple[float, ...]
    tolerance_c: float = 0.5  # half of the 95 % interval of each


def measure_temperature(
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
    at_rest = analyse_temperature(np.array(readings), stated, device)
    if not with_shake or not at_rest.settled:  # a refused result needs no shaken handle
        return at_rest
    text = f"from now on, for {SHAKEN_S:g} s: move the handle back and forth quickly by a few mm"
    ask(Request("shake", text, SHAKEN_S))
    return at_rest + analyse_back_emf(collect(bench, SHAKEN_S).records, device)


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


def analyse_temperature(
    readings: Floats, stated: KnownTemperatures, device: Mapping[str, Any]
) -> StepResult:
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
    follows = len(means) != 2 or abs(means[1] - means[0]) >= LEAST_STEP
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
