"""Faults of the measuring channels that resemble physics, detected in the spectra of a trial.

skew        The velocity is sampled d seconds after the force, which multiplies Z by e^(-jwd) and
            leaves |Z| as it is. Where |Z| grows with f the device is a mass with some damping, of
            phase 90 degrees - b/(w m); any further fall of the phase with f is skew. 125 us turn
            the phase by 22 degrees at 500 Hz and make (d < 0) every passive display look active.
high-pass   An AC-coupled velocity amplifier of corner f_h multiplies Z by 1 + f_h/(jf). Over a
            spring K this adds -K f_h / (2 pi f^2) to Re Z; a delayed force adds a constant instead.
            0.1 Hz looks like 4 ms at 2 Hz.
units       A velocity in mm/s is a thousand times too large, and the display then seems a thousand
            times too light: below a tenth of a gram between 100 and 500 Hz, or light and faster
            than any display. Such a finding does not concern stability.

Skew and high-pass are fitted by least squares with bisquare weights (Beaton and Tukey 1974). The
fit removes the window's own smoothing of a spring, + b s^2 / (2 pi f)^2 with s^2 = pi^2 / (2 M^2
T^2). 90 s of noise reveal a skew from 20 us (the coupling mode of the paper's display causes up to
11 us) and a corner from about 0.4 Hz. To detect a smaller corner, move the lower band edge of a
stiffness limit.

Limitations: a device that is nowhere a mass between 0.06 and 0.4 of the sample rate gives no
finding. A mode in that band with more damping than the paper's is reported as skew: two bodies of
5.5 and 2.5 g with a mode of 660 to 1090 Hz look like up to 27 us at 4 N s/m.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hapticd.core.arrays import Complexes, Floats, Integers
from hapticd.signal.findings import Finding
from hapticd.signal.impedance import impedance, relative_sd
from hapticd.signal.spectra import Spectra

__all__ = ["bisquare_fit"]

SKEW_BAND = (0.06, 0.4)  # of the sample rate: above K, B and M, below the sensors' filters
SEGMENT = 1.08  # ratio of the ends of a stretch of frequencies
MASS_SLOPE = (0.5, 1.7)  # of ln|Z| over ln f
LEAST_SEGMENTS = 5
HIGH_PASS_BAND_HZ = (3.0, 15.0)
SPRING_PHASE_DEG = -30.0  # less spring than that hides a high-pass
LEAST_COHERENCE = 0.2
LEAST_SKEW_S = 20e-6
# skew of the coupling mode of the paper's display (5.5 and 2.5 g, 4e4 N/m, 2 N s/m): 8.7 us fitted,
# plus 1.96 of the fit's deviations of 1.0 us; not a bound for other devices
MODES_SKEW_S = 11e-6
NORMAL = 1.96  # standard deviations to the end of a 95 % interval
WORST_SKEW_SD_S = 5e-6  # above it the device is not a mass with skew
LEAST_HIGH_PASS_HZ = 0.02
CERTAINTY = 4.0  # standard deviations
FASTEST_M_PER_S = 5.0  # rms; device files treat less as a sensor fault
LIGHTEST_KG = 1e-4  # moving mass at the port of a display; the paper's is 8 g
# a display of 3 kg with velocity in mm/s: a fast and heavier one ran away or was pushed hard
FAST_AND_LIGHT_KG = 3e-3
STRONGEST_N = 500.0  # rms; the paper's perturbation was 0.2 N
MASS_BAND_HZ = (100.0, 500.0)
ROUNDS = 12  # of a fit with weights
BISQUARE = 4.685
LEAST_LINES = 8  # of frequencies at which |Z| is known

_NEIGHBOURS = 8.0 / 3.0  # values per independent one: bandwidth over spacing


@dataclass(frozen=True, slots=True)
class Fitted:
    """A fitted number with its standard deviation; nan if there were no data to fit."""

    value: float  # in the unit of the fitted quantity
    sd: float  # standard deviation, same unit


NOT_FITTED = Fitted(float("nan"), float("inf"))


def skew(trial: Spectra) -> Fitted:
    """Fit the seconds by which the velocity is sampled later than the force: a positive skew
    turns the phase down, a negative one up.
    """
    z, f, known = _part(trial, SKEW_BAND[0] * trial.rate_hz, SKEW_BAND[1] * trial.rate_hz)
    stretches = [part for part in _stretches(f) if part.size >= 5 and _is_mass(z[part], f[part])]
    if len(stretches) < LEAST_SEGMENTS:
        return NOT_FITTED
    w = np.array([2.0 * np.pi * f[part].mean() for part in stretches])
    fallen = np.array(
        [-np.angle(np.sum(z[part] * known[part] / (1j * f[part]))) for part in stretches]
    )
    certain = np.array(
        [
            np.sqrt(part.size / _NEIGHBOURS) * (known[part] * np.abs(z[part])).mean()
            for part in stretches
        ]
    )
    return Fitted(*_robust(np.stack((w, 1.0 / w), axis=1), fallen, certain))


def high_pass(trial: Spectra) -> Fitted:
    """Fit the corner [Hz] of a first-order high-pass in the velocity channel, from a trial with
    a spring.
    """
    z, f, known = _part(
        trial, max(HIGH_PASS_BAND_HZ[0], 1.5 * trial.lowest_hz), HIGH_PASS_BAND_HZ[1]
    )
    if z.size < 5 or np.degrees(np.angle(z[0])) > SPRING_PHASE_DEG:
        return NOT_FITTED
    over, _ = _robust(np.stack((1.0 / f, f), axis=1), z.imag, known)
    steep, sd = _robust(
        np.stack((1.0 / f**2, 1.0 + trial.smoothing_hz2 / f**2), axis=1),
        z.real,
        known / np.sqrt(_NEIGHBOURS),
    )
    return Fitted(steep / over, sd / abs(over)) if over else NOT_FITTED


def channel_findings(trial: Spectra) -> tuple[Finding, ...]:
    """Report skew and high-pass that are certain and large enough to matter."""
    return (*_skew_finding(skew(trial)), *_high_pass_finding(high_pass(trial)))


def unit_findings(
    trial: Spectra, force_rms_n: float, velocity_rms_m_per_s: float
) -> Iterator[Finding]:
    """Report a force or velocity beyond that of any display, with the unit it may be in. The
    arguments are the rms values [N, m/s] of a record and its spectra.
    """
    mass_kg = moving_mass_kg(trial)
    fast = velocity_rms_m_per_s > FASTEST_M_PER_S and not mass_kg >= FAST_AND_LIGHT_KG
    if fast or mass_kg < LIGHTEST_KG:
        moved = f" of what weighs {1e3 * mass_kg:.2g} g" if np.isfinite(mass_kg) else ""
        yield Finding(
            "units",
            f"units: velocity of {velocity_rms_m_per_s:.3g} m/s rms{moved}: no display does that;"
            " is the velocity in mm/s? Give m/s",
            voids=True,
        )
    if force_rms_n > STRONGEST_N:
        yield Finding(
            "units",
            f"units: force of {force_rms_n:.3g} N rms: no display takes that; is the force in mN?"
            " Give N",
            voids=True,
        )


def moving_mass_kg(trial: Spectra) -> float:
    """Return the median of |Z| / (2 pi f) [kg] where the display is mostly a mass; nan if fewer
    than 8 frequencies are known.
    """
    z, f, _ = _part(trial, *MASS_BAND_HZ)
    return (
        float(np.median(np.abs(z) / (2.0 * np.pi * f))) if f.size >= LEAST_LINES else float("nan")
    )


def _skew_finding(found: Fitted) -> Iterator[Finding]:
    size = abs(found.value)
    half_s = float(np.hypot(MODES_SKEW_S, NORMAL * found.sd))
    if found.sd <= WORST_SKEW_SD_S and size > max(LEAST_SKEW_S, CERTAINTY * found.sd):
        yield Finding(
            "channel_skew",
            f"channel skew: velocity sampled {1e6 * size:.3g} us (+-{1e6 * half_s:.2g})"
            f" {'after' if found.value > 0.0 else 'before'} the force; sample both together, or"
            f" take a skew that is known out with --skew {found.value:.3g}",
            voids=True,
        )


def _high_pass_finding(found: Fitted) -> Iterator[Finding]:
    if found.value > max(LEAST_HIGH_PASS_HZ, CERTAINTY * found.sd):
        yield Finding(
            "high_pass_mismatch",
            f"high-pass mismatch: the velocity channel looks AC-coupled at {found.value:.3g} Hz"
            f" (+-{found.sd:.2g}); couple it to DC, take a corner that is known out with"
            f" --high-pass {found.value:.2g}, or judge from a higher frequency",
            voids=True,
        )


def _part(trial: Spectra, low_hz: float, high_hz: float) -> tuple[Complexes, Floats, Floats]:
    """Return impedance, frequency and weight 1/sd of Re Z between two frequencies, where there is
    coherence.
    """
    use = (
        (trial.frequency_hz >= low_hz)
        & (trial.frequency_hz <= high_hz)
        & (trial.coherence > LEAST_COHERENCE)
    )
    z = impedance(trial, "h_force").impedance_ns_per_m[use]
    spread = np.abs(z) * relative_sd(trial.coherence[use], trial.degrees_of_freedom)
    return z, trial.frequency_hz[use], 1.0 / np.maximum(spread, 1e-6 * np.abs(z) + 1e-300)


def _robust(columns: Floats, values: Floats, weight: Floats) -> tuple[float, float]:
    """Fit `columns` to `values` with `weight` = 1/sd; return the first coefficient and its standard
    deviation.
    """
    scaled = columns * weight[:, None]
    solution, _, trust, scale = bisquare_fit(scaled, values * weight, 1.0)
    normal = np.linalg.pinv((scaled * trust[:, None]).T @ scaled)
    return float(solution[0]), scale * float(np.sqrt(normal[0, 0]))


def _stretches(frequency_hz: Floats) -> list[Integers]:
    """Indices of neighbouring frequencies, `SEGMENT` apart from end to end."""
    if not frequency_hz.size:
        return []
    place = np.floor(np.log(frequency_hz / frequency_hz[0]) / np.log(SEGMENT))
    return np.split(np.arange(frequency_hz.size), np.flatnonzero(np.diff(place)) + 1)


def _is_mass(z: Complexes, frequency_hz: Floats) -> bool:
    """Whether |Z| grows with the frequency here."""
    slope = np.polyfit(np.log(frequency_hz), np.log(np.abs(z)), 1)[0]
    return bool(MASS_SLOPE[0] <= slope <= MASS_SLOPE[1])


def bisquare_fit(
    columns: Floats, values: Floats, least_scale: float
) -> tuple[Floats, Floats, Floats, float]:
    """Least squares of `values` (n,) on `columns` (n, c) with bisquare weights (Beaton and Tukey
    1974). Return coefficients (c,), residuals and weights (n,), and their scale, which is at least
    `least_scale`.
    """
    trust = np.ones(values.size)
    for _ in range(ROUNDS):
        root = np.sqrt(trust)
        solution = np.linalg.lstsq(columns * root[:, None], values * root, rcond=None)[0]
        residual = values - columns @ solution
        scale = max(least_scale, 1.4826 * float(np.median(np.abs(residual))))
        trust = np.maximum(0.0, 1.0 - (residual / (BISQUARE * scale)) ** 2) ** 2
    return np.asarray(solution, np.float64), residual, trust, scale
