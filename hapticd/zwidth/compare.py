"""Comparison of displays: one number per device, and the conditions under which two may be
compared.

Numbers, from the envelope and from other work:

    width_db                        mean of 20 log10(upper/lower) of the envelope over a band of
                                    ln f: the Z-width in decibels
    stiffness_damping_area          area of the passive region in the K-B plane at one virtual mass
                                    (Colgate and Brown 1994)
    stiffness_at, stiffness_rate    largest passive K at a virtual damping B, and its slope there
    zero_mass_bandwidth_hz          bandwidth in which a device that renders no mass moves freely:
                                    -3 dB of |1/Z| from its largest value

Conditions. Two displays bolted together have twice the K, B and M, and are not a better display:
"Has performance really improved, or is this simply a larger device?" (Weir, Colgate and Peshkin
2008, section 2). Divided by the moving mass, impedances [1/s], stiffness [1/s^2] and damping [1/s]
of the pair equal those of the single one (`normalised`). The envelope in decibels needs no
division, because maximum and minimum double together. Friction and perturbation scale with the mass
too, so the perturbation's density is compared per mass squared. `check_alike` refuses to compare
envelopes measured under unlike conditions unless the differences are allowed by name.

A band outside the envelope is refused, and so is a K-B map without the value of M.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from hapticd.core.arrays import Complexes, Floats
from hapticd.core.errors import AnalysisError
from hapticd.zwidth.passive_set import Edge, Envelope, PassiveSet

__all__ = [
    "EnvelopeConditions",
    "check_alike",
    "mean_over_ln_f",
    "normalised",
    "stiffness_damping_area",
    "stiffness_rate",
    "widths_db",
    "zero_mass_bandwidth_hz",
]

BANDS_HZ = ((2.0, 10.0), (10.0, 50.0), (50.0, 200.0), (200.0, 500.0))
CLOSE = 0.02  # relative difference below which numbers count as equal
FREE = ("device", "mass_kg")  # conditions that may differ
# power of the mass by which a condition is divided before comparison
PER_MASS = {"probe_mass_kg": 1, "perturbation_psd_n2_per_hz": 2}


@dataclass(frozen=True, slots=True)
class BandWidth:
    """Mean width [dB] of an envelope between two frequencies."""

    low_hz: float
    high_hz: float
    width_db: float


def width_db(found: Envelope, low_hz: float, high_hz: float) -> float:
    """Return the mean width [dB] of an envelope over ln f between two frequencies. AnalysisError
    unless the envelope has two values there.
    """
    return float(mean_over_ln_f(found.frequency_hz, found.width_db(), (low_hz, high_hz)))


def mean_over_ln_f(frequency_hz: Floats, values: Floats, band_hz: tuple[float, float]) -> Floats:
    """Return the mean (...,) of `values` (..., F) over ln f inside the band. AnalysisError unless
    two of the frequencies (F,) [Hz] lie there.
    """
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
    """Return `width_db` of several bands, by default of `BANDS_HZ`."""
    return tuple(BandWidth(low, high, width_db(found, low, high)) for low, high in bands_hz)


def stiffness_damping_area(found: PassiveSet, mass_kg: float = 0.0) -> float:
    """Return the area [N/m N s/m] of the passive region of the K-B plane with K >= 0 and B >= 0 at
    that virtual mass, as a stiffness-damping plot shows it.
    """
    stiffness, damping, _ = found.axes
    kept = np.flatnonzero(damping >= 0.0)
    if kept.size < 2:
        return 0.0
    highest = np.array(
        [_highest(stiffness, found.margin[:, row, _plane(found, mass_kg)]) for row in kept]
    )
    return float(np.trapezoid(np.nan_to_num(highest), damping[kept]))


def stiffness_at(found: PassiveSet, virtual_damping_ns_per_m: float, mass_kg: float = 0.0) -> float:
    """Return the largest passive K [N/m] at this virtual damping, linear between grid lines; nan if
    none is passive. AnalysisError outside the grid.
    """
    stiffness, damping, _ = found.axes
    if not damping[0] <= virtual_damping_ns_per_m <= damping[-1]:
        raise AnalysisError(
            f"virtual damping B = {virtual_damping_ns_per_m:g} N s/m lies outside the grid"
            f" {damping[0]:g}..{damping[-1]:g}"
        )
    plane = found.margin[:, :, _plane(found, mass_kg)]
    above = min(int(np.searchsorted(damping, virtual_damping_ns_per_m, "right")), damping.size - 1)
    share = (virtual_damping_ns_per_m - damping[above - 1]) / (damping[above] - damping[above - 1])
    return _highest(
        stiffness, np.asarray((1.0 - share) * plane[:, above - 1] + share * plane[:, above])
    )


def stiffness_rate(
    found: PassiveSet, virtual_damping_ns_per_m: float, mass_kg: float = 0.0
) -> float:
    """Return the slope dK/dB [1/s] of the boundary at this virtual damping, over one step of the
    grid (one-sided at its ends).
    """
    damping = found.axes[1]
    step = float(np.min(np.diff(damping)))
    low = max(float(damping[0]), virtual_damping_ns_per_m - 0.5 * step)
    high = min(float(damping[-1]), virtual_damping_ns_per_m + 0.5 * step)
    return (stiffness_at(found, high, mass_kg) - stiffness_at(found, low, mass_kg)) / (high - low)


def zero_mass_bandwidth_hz(frequency_hz: Floats, impedance_ns_per_m: Complexes) -> float:
    """Return the frequency [Hz] where |Z| (F,), rendered with M = 0, has grown by sqrt(2) from its
    minimum; inf if it never does.

    For a mass m with damping b alone it is b / (2 pi m).
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
    """Return the first crossing upwards from the lowest passive K >= 0; nan if none is passive."""
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


@dataclass(frozen=True, slots=True)
class EnvelopeConditions:
    """Conditions under which an envelope was found. `device` and `mass_kg` may differ between
    compared displays; all others must be alike.
    """

    device: str  # name of the display
    mass_kg: float  # total moving mass at the port
    port: str = "probe"  # where force and velocity were measured
    probe_mass_kg: float = 0.0  # added to measure; 0 for none
    rate_hz: float = 1000.0  # of the servo
    filters_hz: tuple[float, float] = (100.0, 72.0)  # corners of velocity and acceleration
    band_hz: tuple[float, float] = (2.0, 500.0)  # judged band
    estimator: str = "spa"  # of Z: "spa" or "h_force"
    grip: str = "free"  # how the display was held
    perturbation_psd_n2_per_hz: float = 0.0  # one-sided density of the perturbing force
    judged_hz: tuple[float, float] = (2.0, 500.0)  # first and last judged frequency
    confidence: float = 0.95  # of the verdicts
    seconds: float = 90.0  # of a trial
    simulated: bool = True  # whether trials were simulated


def differences(one: EnvelopeConditions, other: EnvelopeConditions) -> tuple[str, ...]:
    """Return the unlike conditions by name; those proportional to the mass compare per mass."""
    return tuple(
        item.name
        for item in fields(EnvelopeConditions)
        if item.name not in FREE and not _alike(item.name, one, other)
    )


def check_alike(
    conditions: Sequence[EnvelopeConditions], allow: Collection[str] = ()
) -> tuple[str, ...]:
    """Return the names of the conditions in which the others differ from the first. AnalysisError
    unless `allow` contains all of them.

    Conditions that differ but agree per mass count as alike, as for displays of other masses at the
    same probe under the same perturbation.
    """
    first = conditions[0]
    unlike = list[str]()
    for other in conditions[1:]:
        same = [name for name in PER_MASS if _close(getattr(first, name), getattr(other, name))]
        found = [name for name in differences(first, other) if name not in same]
        unlike += found
        if refused := [name for name in found if name not in allow]:
            said = "; ".join(
                f"{name}: {getattr(first, name)!r} and {getattr(other, name)!r}" for name in refused
            )
            raise AnalysisError(
                f"{first.device} and {other.device} were measured under unlike conditions: {said}; "
                "measure them under the same conditions, or compare them anyway with"
                f" --allow {','.join(refused)}"
            )
    return tuple(dict.fromkeys(unlike))


def normalised(found: Envelope, mass_kg: float) -> Envelope:
    """Return `found` per kilogram of moving mass: Z/m [1/s], or Y m [s]. AnalysisError without a
    mass.
    """
    if not mass_kg > 0.0:
        raise AnalysisError(
            f"mass {mass_kg} kg: the mass that moves at the port must be positive to divide by it"
        )
    factor = 1.0 / mass_kg if found.kind == "impedance" else mass_kg
    upper, lower = (
        Edge(factor * edge.value, edge.sd, edge.owner) for edge in (found.upper, found.lower)
    )
    return replace(found, upper=upper, lower=lower)


def _alike(name: str, one: EnvelopeConditions, other: EnvelopeConditions) -> bool:
    a = getattr(one, name)
    b = getattr(other, name)
    if not isinstance(a, float):
        return bool(a == b)
    power = PER_MASS.get(name, 0)
    return _close(a / one.mass_kg**power, b / other.mass_kg**power)


def _close(a: float, b: float) -> bool:
    return bool(abs(a - b) <= CLOSE * max(abs(a), abs(b)))
