"""One number for a device: ours from the envelope, and those that others use, so that they can be
read side by side.

    width_db            mean of 20 log10(upper/lower) of the envelope over a band of ln f: the
                        Z-width in decibels
    stiffness_damping_area     area of the passive region in the K-B plane at one virtual mass
                               (Colgate and Brown 1994)
    stiffness_at, stiffness_rate    largest passive K at a damping B, and how it changes with B
                                    there
    zero_mass_bandwidth_hz     up to where a device that renders no mass moves freely: -3 dB of
                               |1/Z| above its largest value

What would break it: a band that the envelope does not cover, or a K-B map without the value of M
(both refused).
"""

from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Complexes, Floats
from hapticd.analysis.boundary import PassiveSet
from hapticd.analysis.envelope import Envelope
from hapticd.errors import AnalysisError

BANDS_HZ = ((2.0, 10.0), (10.0, 50.0), (50.0, 200.0), (200.0, 500.0))


@dataclass(frozen=True, slots=True)
class BandWidth:
    """Mean width [dB] of an envelope between two frequencies."""

    low_hz: float
    high_hz: float
    width_db: float


def width_db(found: Envelope, low_hz: float, high_hz: float) -> float:
    """Mean width [dB] over ln f between two frequencies. AnalysisError unless the envelope has
    two values there.
    """
    return float(mean_over_ln_f(found.frequency_hz, found.width_db(), (low_hz, high_hz)))


def mean_over_ln_f(frequency_hz: Floats, values: Floats, band_hz: tuple[float, float]) -> Floats:
    """Mean (...,) of `values` (..., F) over ln f inside the band. AnalysisError unless two of the
    frequencies (F,) [Hz] are there."""
    low_hz, high_hz = band_hz
    inside = (frequency_hz >= low_hz) & (frequency_hz <= high_hz)
    if inside.sum() < 2:
        raise AnalysisError(
            f"the envelope has no two frequencies in {low_hz:g}..{high_hz:g} Hz; ask for a band"
            " that it covers"
        )
    place = np.log(frequency_hz[inside])
    return np.asarray(np.trapezoid(values[..., inside], place) / (place[-1] - place[0]))


def widths_db(
    found: Envelope, bands_hz: tuple[tuple[float, float], ...] = BANDS_HZ
) -> tuple[BandWidth, ...]:
    """`width_db` of several bands."""
    return tuple(BandWidth(low, high, width_db(found, low, high)) for low, high in bands_hz)


def stiffness_damping_area(found: PassiveSet, mass_kg: float = 0.0) -> float:
    """Area [N/m N s/m] of the passive K-B region with K >= 0, B >= 0 at that virtual mass, as
    in a stiffness-damping plot.
    """
    stiffness, damping, _ = found.axes
    kept = np.flatnonzero(damping >= 0.0)
    if kept.size < 2:
        return 0.0
    highest = np.array(
        [_highest(stiffness, found.margin[:, row, _plane(found, mass_kg)]) for row in kept]
    )
    return float(np.trapezoid(np.nan_to_num(highest), damping[kept]))


def stiffness_at(found: PassiveSet, damping_ns_per_m: float, mass_kg: float = 0.0) -> float:
    """Largest passive K [N/m] at a damping, between grid lines linearly; nan where none is
    passive.
    """
    stiffness, damping, _ = found.axes
    if not damping[0] <= damping_ns_per_m <= damping[-1]:
        raise AnalysisError(
            f"damping {damping_ns_per_m:g} N s/m lies outside the grid"
            f" {damping[0]:g}..{damping[-1]:g}"
        )
    plane = found.margin[:, :, _plane(found, mass_kg)]
    above = min(int(np.searchsorted(damping, damping_ns_per_m, "right")), damping.size - 1)
    share = (damping_ns_per_m - damping[above - 1]) / (damping[above] - damping[above - 1])
    return _highest(
        stiffness, np.asarray((1.0 - share) * plane[:, above - 1] + share * plane[:, above])
    )


def stiffness_rate(found: PassiveSet, damping_ns_per_m: float, mass_kg: float = 0.0) -> float:
    """dK/dB [1/s] of the boundary at that damping, over one step of the grid (one-sided at its
    ends).
    """
    damping = found.axes[1]
    step = float(np.min(np.diff(damping)))
    low = max(float(damping[0]), damping_ns_per_m - 0.5 * step)
    high = min(float(damping[-1]), damping_ns_per_m + 0.5 * step)
    return (stiffness_at(found, high, mass_kg) - stiffness_at(found, low, mass_kg)) / (high - low)


def zero_mass_bandwidth_hz(frequency_hz: Floats, impedance_ns_per_m: Complexes) -> float:
    """Where |Z| (F,), rendered with M = 0, has grown by sqrt(2) over its least value; inf if it
    never does.

    Of a mass m with damping b alone: b / (2 pi m).
    """
    size = np.abs(impedance_ns_per_m)
    least = int(np.argmin(size))
    beyond = np.flatnonzero(size[least:] >= np.sqrt(2.0) * size[least])
    if not beyond.size:
        return float("inf")
    at = least + int(beyond[0])
    level = np.log(size[at - 1 : at + 1])
    f = np.log(frequency_hz[at - 1 : at + 1])
    return float(np.exp(np.interp(np.log(np.sqrt(2.0) * size[least]), level, f)))


def _plane(found: PassiveSet, mass_kg: float) -> int:
    nearest = int(np.argmin(np.abs(found.axes[2] - mass_kg)))
    if not np.isclose(found.axes[2][nearest], mass_kg, rtol=1e-9, atol=1e-12):
        raise AnalysisError(
            f"the grid has no virtual mass {mass_kg:g} kg; the nearest is"
            f" {found.axes[2][nearest]:g} kg"
        )
    return nearest


def _highest(stiffness: Floats, margin: Floats) -> float:
    """First crossing upwards from the lowest passive K >= 0; nan if none is passive."""
    start = np.flatnonzero((stiffness >= 0.0) & (margin >= 0.0))
    if not start.size:
        return float("nan")
    failing = np.flatnonzero(~(margin[start[0] :] >= 0.0))
    if not failing.size:
        return float(stiffness[-1])
    last = start[0] + int(failing[0]) - 1
    low = margin[last]
    high = margin[last + 1]
    share = low / (low - high) if np.isfinite(high) else 0.0
    return float(stiffness[last] + share * (stiffness[last + 1] - stiffness[last]))
