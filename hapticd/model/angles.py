"""The angles wT at which a device is evaluated, and the minimum between them.

Density (`angles_of`). The condition of `theorem` depends on the device alone through e = G - E, h
and q. Their only poles are those of the device with its probe held still, folded into the base
band; the poles of the free device cancel. A pole w_i - j v_i makes a feature at least v_i T wide. A
ladder of angles with geometric distances from v_i T therefore surrounds it, up to where the fixed
angles are denser. The law's filters have no ladder.

Minimum (`least_between`). A parabola through a minimum and its neighbours estimates the true
minimum. Its error is 0.1 % of an edge with the filters of the paper, and 2 % with one of ratio 0.3
at 8 to 64 Hz. Margins, maps and `coupled.withstands` use it. The yes or no of the guard does not:
it is exact between angles (`rational`).

Limitations: a mode whose width is below the resolution of the arithmetic (`unresolved_hz`).
"""

import numpy as np

from hapticd.core.arrays import Complexes, Floats, Integers
from hapticd.model.loop import port_states
from hapticd.model.model import Model

__all__ = ["FIXED", "angles_of", "held_poles", "least_between", "unresolved_hz", "vertices"]

_STEP = np.pi / 500.0  # about that of the fixed angles, above _LINEAR
_LINEAR = 0.05  # rad; below it they are geometric
_FIRST = 2e-3  # rad
FIXED = np.concatenate(
    (np.geomspace(_FIRST, _LINEAR, 24)[:-1], np.linspace(_LINEAR, np.pi, 480))
)  # wT, where there are no modes
_RATIO = 1.17  # of neighbouring distances from a pole
_CLOSEST = 0.1  # of a half-width
_NARROWEST = 1e-8  # rad, half-width; less cannot be resolved
_FARTHEST = 7.0  # fixed steps: beyond it the ladder is not denser


def held_poles(model: Model, active_damping_ns_per_m: float) -> Complexes:
    """Return the poles [rad/s] (n - 1,) of `model` with its probe held still."""
    rotor = port_states(model)[0]
    held = np.delete(np.delete(model.a(active_damping_ns_per_m), rotor, 0), rotor, 1)
    return np.linalg.eigvals(held).astype(np.complex128)


def angles_of(model: Model, active_damping_ns_per_m: float = 0.0) -> Floats:
    """Return the angles wT (A,) in 0..pi, ascending, at which `model` is evaluated: `FIXED`, and
    denser about its modes.
    """
    centre, half = _modes(model, active_damping_ns_per_m)
    half = np.maximum(half, _NARROWEST)
    step = np.where(centre < _LINEAR, 0.14 * centre, _STEP)
    sides = [
        away
        for at, width, end in zip(centre, half, _FARTHEST * step, strict=True)
        for away in (at - _ladder(width, end), at + _ladder(width, end))
    ]
    found = np.abs(np.concatenate((FIXED, centre, *sides)))
    mirrored = np.where(found > np.pi, 2.0 * np.pi - found, found)
    return np.unique(mirrored[mirrored >= _FIRST])


def _ladder(half_width: float, end: float) -> Floats:
    """Distances from a pole, from a tenth of its half-width to `end`."""
    count = int(np.log(max(end / (_CLOSEST * half_width), 1.0)) / np.log(_RATIO))
    return np.asarray(_CLOSEST * half_width * _RATIO ** np.arange(count))


def _modes(model: Model, active_damping_ns_per_m: float) -> tuple[Floats, Floats]:
    """Return the angle of each mode with the probe held still, folded to 0..pi, and its half-width
    [rad].
    """
    poles = held_poles(model, active_damping_ns_per_m) / model.rate_hz
    poles = poles[poles.imag > 0.0]
    return np.abs(np.remainder(poles.imag + np.pi, 2.0 * np.pi) - np.pi), np.abs(poles.real)


def unresolved_hz(model: Model, active_damping_ns_per_m: float) -> list[float]:
    """Return the modes [Hz] of `model` with its probe held still that are too narrow to resolve; on
    such a device no environment can be judged.
    """
    poles = held_poles(model, active_damping_ns_per_m)
    narrow = (poles.imag > 0.0) & (np.abs(poles.real) < _NARROWEST * model.rate_hz)
    return [float(hz) for hz in np.sort(poles.imag[narrow]) / (2.0 * np.pi)]


def least_between(angles: Floats, values: Floats) -> Floats:
    """Return the minimum (N,) of `values` (N, A) over `angles` (A,) and between them."""
    lowest = values.min(axis=1)
    row, _, least = vertices(angles, values)
    np.minimum.at(lowest, row, least)
    return np.asarray(lowest)


def vertices(angles: Floats, values: Floats) -> tuple[Integers, Integers, Floats]:
    """Return row, index and minimum of the parabola through each of `values` (N, A) below both
    neighbours, three arrays (m,).
    """
    falls = values[:, 1:-1] <= values[:, :-2]
    row, place = np.nonzero(falls & (values[:, 1:-1] <= values[:, 2:]))
    place += 1
    middle = values[row, place]
    below = angles[place] - angles[place - 1]
    above = angles[place + 1] - angles[place]
    falling = (middle - values[row, place - 1]) / below
    rising = (values[row, place + 1] - middle) / above
    bend = np.maximum((rising - falling) / (below + above), np.finfo(np.float64).tiny)
    slope = falling + bend * below
    return row, place, middle - 0.25 * slope * slope / bend
