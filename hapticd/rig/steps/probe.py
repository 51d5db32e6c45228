"""Calibration of the probe's two channels by encoder and a known mass: gains, signs, offsets,
noise.

The perturbation shakes the free handle at 10 to 30 Hz (`excitation`), first alone, then with a
known mass fixed to it.

The encoder gives scale and sign of the velocity channel; the torque added by the mass gives those
of the torque channel. One signal into both channels shows the difference of their phases.
`probe_fits` has these fits.

Dead and swapped channels are detected before the fits. The perturbation is known: the torque
channel has to follow it, with a delay at most, and the velocity channel the encoder's velocity.

Limitations: a mass that rattles (it appears in the residuals), or one fixed to something soft (its
mode has to be far above 30 Hz).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import floor, hypot, pi, sqrt
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.client.client import Client
from hapticd.core.arrays import Complexes, Floats
from hapticd.core.errors import AnalysisError
from hapticd.core.units import percent
from hapticd.rig.excitation import (
    LINES_HZ,
    PERIOD_S,
    Lines,
    Recording,
    lines,
    recording,
    rms,
    sine_run,
    sines,
)
from hapticd.rig.experiment import begin_step, record
from hapticd.rig.result import (
    NORMAL,
    POSITION_HALF,
    Ask,
    Change,
    Finding,
    Request,
    StepResult,
    Value,
    change_of,
    checked,
    plausible,
    relative_half,
    settled,
)
from hapticd.rig.steps.motor import GRAVITY_M_PER_S2
from hapticd.rig.steps.probe_fits import (
    SIGNAL_S,
    Added,
    Channel,
    Phase,
    ReferenceSpring,
    fit_added_mass,
    fit_velocity_channel,
    phase,
)
from hapticd.usb.codec import I16_HIGHEST

__all__ = ["AttachedMass", "measure"]

REST_S = 12.0  # high-passes of 0.1 Hz take several seconds to settle
QUARTERS = 4
MOVED_M = 20e-6  # rms
LEAST_COUNTS = 5.0  # rms of a channel that is not dead
HEAVIEST = 2.0  # weight of the fixed mass, times the force limit
LEAST_COHERENT = 0.9  # share of a channel's lines that follows its reference
MOST_LEFT = 0.05  # of the torque's lines, left by the fit
WORST_HALF = 0.1  # of the force gain, beyond which the mass had no effect
SHEPPARD = 1.0 / 12.0  # variance of rounding (Sheppard 1898), valid from half a count of noise
SHIFTS = np.linspace(-1.0, 1.0, 1001)  # of the longest delay, at which lines are compared
LATEST_S = 2e-3  # between encoder and probe


@dataclass(frozen=True)
class AttachedMass:
    """The mass fixed to the handle."""

    kilograms: float
    tolerance: float = 1e-3  # relative, half of its 95 % interval


class Recordings(NamedTuple):
    """Recordings of the step; None: not requested."""

    rest: Recording
    bare: Recording
    loaded: Recording | None = None
    one: Recording | None = None


class Gain(NamedTuple):
    """Value of a count, with its sign, and half of its 95 % interval."""

    per_count: float
    relative_half: float

    @property
    def sign(self) -> int:
        """Sign of the channel, as in the device file."""
        return 1 if self.per_count > 0.0 else -1

    def value(self, name: str, unit: str) -> Value:
        """Return the value of the full count."""
        full = I16_HIGHEST * abs(self.per_count)
        return Value.around(name, full, unit, full * self.relative_half)


def measure(
    bench: Client,
    ask: Ask,
    attached: AttachedMass,
    judged: ReferenceSpring | None = None,
    with_one_signal: bool = True,
) -> StepResult:
    """Record the channels at rest, shaken without and with the mass, and under one signal, and
    evaluate. CommandError unless disabled; AnalysisError if the signs are not verified, force ends
    or the handle drifts off.
    """
    # without the weak spring the smallest slope moves the handle while it is shaken
    device = begin_step(bench, "the probe is measured")["device"]
    if not attached.kilograms > 0.0:
        raise AnalysisError(f"mass {attached.kilograms:g} kg: name the one that is fixed, in kg")
    if attached.kilograms * GRAVITY_M_PER_S2 > HEAVIEST * float(device["force_limit_n"]):
        raise AnalysisError(
            f"{attached.kilograms:g} kg weigh more than {HEAVIEST:g} times the force of the device,"
            f" {device['force_limit_n']:g} N; fix less, or is it in grams?"
        )
    ask(Request("let go", "let go of the handle near x = 0, and let it come to rest"))
    found = Recordings(recording(record(bench, REST_S)), sine_run(bench))
    if settled(channels(lines(found.bare))):
        text = f"fix {attached.kilograms:g} kg firmly to the handle and let go of it"
        ask(Request("attach", text, attached.kilograms))
        found = found._replace(loaded=sine_run(bench))
        ask(Request("let go", "take the mass off again and let go of the handle"))
        if with_one_signal:
            text = f"feed one signal into both probe channels for {SIGNAL_S:g} s from now"
            ask(Request("one signal", text, SIGNAL_S))
            found = found._replace(one=recording(record(bench, SIGNAL_S)))
    return analyse(found, attached, device, judged or ReferenceSpring())


def analyse(
    found: Recordings, attached: AttachedMass, device: Mapping[str, Any], judged: ReferenceSpring
) -> StepResult:
    """Evaluate the recordings, with the scales of the hello's `device`."""
    bare = lines(found.bare)
    result = StepResult("probe", findings=channels(bare), arrays=_arrays(found))
    if not result.settled:
        return result
    turned, of_signal = _compared(found.one, judged)
    result += of_signal
    if found.loaded is None or not result.settled:
        return result
    of_velocity = fit_velocity_channel(bare)
    fit = fit_added_mass(found.bare, found.loaded, of_velocity, turned)
    return result + _scales(found.rest, fit, of_velocity, attached, device)


def _compared(one: Recording | None, judged: ReferenceSpring) -> tuple[Floats, StepResult]:
    """Return the phase (l,) of the velocity channel against the torque channel, and findings."""
    if one is None:
        found: Phase | Finding = Finding(
            "skew and high-pass mismatch",
            "not done",
            "feed one signal into both channels; the force gain may be off by some 0.5 %",
        )
    else:
        found = phase(one.torque, one.velocity)
    if isinstance(found, Finding):
        return np.zeros(len(LINES_HZ)), StepResult("probe", findings=[found])
    return found.at(LINES_HZ), found.result(judged)


def _scales(
    rest: Recording,
    fit: Added,
    of_velocity: Channel,
    attached: AttachedMass,
    device: Mapping[str, Any],
) -> StepResult:
    """Return scales, offsets and noise of both channels."""
    half = relative_half(device["position"], POSITION_HALF)
    torque = force_gain(fit, attached, half)
    velocity = Gain(1.0 / of_velocity.counts, hypot(of_velocity.relative_half, half))
    gains = {"probe_torque": torque, "probe_velocity": velocity}
    remedy = "check that the mass is in kg and attached; if so, correct the full scale in the file"
    findings = [
        *_weighed(fit),
        *(plausible(name, one.per_count, device[name], remedy) for name, one in gains.items()),
    ]
    full = torque.value("probe_torque.full_scale_n", "N")
    scales = [
        full,
        velocity.value("probe_velocity.full_scale_m_per_s", "m/s"),
        offset("probe_torque.offset_count", rest.torque),
        offset("probe_velocity.offset_count", rest.velocity),
    ]
    noises = [
        noise("probe_torque noise", rest.torque, torque, "N rms"),
        noise("probe_velocity noise", rest.velocity, velocity, "m/s rms"),
    ]
    changes = [*(Change(name, "sign", one.sign) for name, one in gains.items())]
    changes += map(change_of, scales)
    if full.low < device["probe_limit_n"]:
        # the converter does not exceed its full scale, whatever the limit in the file
        changes.append(Change("limits", "probe_n", floor(full.low * 1e3) / 1e3))
    return StepResult("probe", [*scales, *noises], findings, changes)


def channels(bare: Lines) -> list[Finding]:
    """Detect dead and swapped channels, from lines without a mass."""
    torque = rms(bare.torque)
    velocity = rms(bare.velocity)
    moved_m = rms(bare.position_m)
    seen = (
        f"handle {1e3 * moved_m:.3g} mm rms, torque channel {torque:.4g} counts, velocity"
        f" channel {velocity:.4g} counts"
    )
    moved = moved_m >= MOVED_M
    followed = velocity >= LEAST_COUNTS
    if followed and not moved:
        remedy = "stuck encoder: the velocity channel moves without it"
    elif torque < LEAST_COUNTS:
        remedy = "dead probe channel: no torque; check the probe's amplifier and this input"
    elif not moved:
        remedy = "the probe does not move the handle: release it, check the probe's motor"
    elif not followed:
        remedy = "dead probe channel: no velocity; check its coil, amplifier and this input"
    else:
        return [Finding(seen, "ok"), _in_place(bare)]
    return [Finding(seen, "refused", remedy)]


def _in_place(bare: Lines) -> Finding:
    speed = 2j * pi * LINES_HZ * bare.position_m
    played = np.fft.rfft(sines(1.0))[LINES_HZ.astype(int)]  # a line for each Hz: it lasts 1 s
    right = (alike(bare.torque, played, PERIOD_S), alike(bare.velocity, speed, LATEST_S))
    wrong = (alike(bare.velocity, played, PERIOD_S), alike(bare.torque, speed, LATEST_S))
    what = (
        f"torque agrees with the played signal to {100 * right[0]:.3g} %, velocity with the"
        f" encoder to {100 * right[1]:.3g} %"
    )
    if min(wrong) > max(min(right), LEAST_COHERENT):
        return Finding(
            f"{what}; crosswise {100 * min(wrong):.3g} %",
            "refused",
            "probe channels swapped: exchange the two inputs of the board",
        )
    return checked(
        what,
        min(right) >= LEAST_COHERENT,
        "release the handle; check the probe's mounting and both channels",
        "refused",
    )


def alike(found: Complexes, known: Complexes, latest_s: float) -> float:
    """Return the share of the power of `found` (l,) that is `known` (l,) of either sign, delayed by
    up to `latest_s` either way.
    """
    turns = np.exp(-2j * pi * np.outer(latest_s * SHIFTS, LINES_HZ))
    common = (turns @ (known * found.conj())).real ** 2
    power = np.sum(np.abs(found) ** 2) * np.sum(np.abs(known) ** 2)
    return float(common.max() / power)


def force_gain(found: Added, attached: AttachedMass, position_half: float) -> Gain:
    """Return N per count."""
    relative = hypot(found.half / found.counts, attached.tolerance, position_half)
    return Gain(attached.kilograms / found.counts, relative)


def _weighed(found: Added) -> Iterator[Finding]:
    """Yield findings on the fit of both recordings."""
    yield checked(
        f"masses, damping and friction leave {percent(found.left)} of the torque unexplained",
        found.left <= MOST_LEFT,
        "fix the mass so that it does not rattle, and keep hands and table still",
    )
    relative = found.half / abs(found.counts)
    if relative > WORST_HALF:
        yield Finding(
            f"the mass alone determines the force to {percent(relative)}",
            "refused",
            "was it fixed? Repeat it, or take a heavier one",
        )


def offset(name: str, counts: Floats) -> Value:
    """Return the mean of the last quarter of `counts` (n,) at rest, with its drift."""
    quarter = len(counts) // QUARTERS
    last = counts[-quarter:]
    mean = float(last.mean())
    spread = float(last.std())
    drift = mean - float(counts[-2 * quarter : -quarter].mean())
    # a channel that moves by less than half a count hides its place within the count
    half = hypot(NORMAL * spread / sqrt(quarter), drift, 0.5 if spread < 0.5 else 0.0)
    return Value.around(name, mean, "counts", half)


def noise(name: str, counts: Floats, gain: Gain, unit: str) -> Value:
    """Return the noise of the last quarter of `counts` (n,) at rest, without that of rounding."""
    last = counts[-(len(counts) // QUARTERS) :]
    spread = float(last.std())
    per_count = abs(gain.per_count)
    if spread < 0.5:
        return Value(name, spread * per_count, unit, 0.0, 0.5 * per_count)
    value = sqrt(spread**2 - SHEPPARD) * per_count
    half = value * hypot(NORMAL / sqrt(2.0 * len(last)), gain.relative_half)
    return Value.around(name, value, unit, half)


def _arrays(found: Recordings) -> dict[str, npt.NDArray[Any]]:
    return {
        f"{name}_{key}": array
        for name, one in found._asdict().items()
        if one is not None
        for key, array in one._asdict().items()
    }
