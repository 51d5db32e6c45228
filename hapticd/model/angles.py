"""The frequencies at which a device is evaluated, and the minimum between them.

Density (`angles_of`). The condition of `theorem` depends on the device alone through e = G - E, h
and q, at angles wT. Their only poles are those of the device with its probe held still, folded into
the base band; the poles of the free device cancel. A pole w_i - j v_i makes a feature at least v_i
T wide. A ladder of angles with geometric distances from v_i T therefore surrounds it, up to where
the fixed angles are denser. The law's filters have no ladder.

Minimum between angles (`least_between`). A parabola through a minimum and its neighbours estimates
the true minimum. Its error is 0.1 % of an edge with the filters of the paper, and 2 % with one of
ratio 0.3 at 8 to 64 Hz. Margins, maps and `coupled.withstands` use it. The yes or no of the guard
does not: it is exact between angles (`rational`). Limitations: a mode whose width is below the
resolution of the arithmetic (`unresolved_hz`).

Narrow dips of Re Z between lines (`min_real_part`). They are searched for at the poles of the loop.
With G the pulse transfer of the command, C the law, E the part of G that passes through the probe
at w, and h, q the transfers from command to probe and from probe to encoder (see `theorem`),

    Z = 1/P_vt + C h q / (1 + C (G - E))

is sharp only near its poles: the modes of the device with its probe held still (zeros of P_vt) and
the aliases of its free modes (poles of G), both moved by the law. Steps of 6 % miss a mode of 1 %:
they read +0.38 where Re Z falls to -0.93 N s/m over 8 Hz. Therefore:

1. `mode_lines` adds a few lines around each mode that is narrower than the grid, for all
   environments;
2. `min_real_part` approximates Z between three neighbouring lines by (a + b x) / (1 + c x), exact
   for one pole on a constant. The minimum real part of that has a closed form. If it is below the
   minimum so far, Z is computed for that environment alone, and the dip followed. Only computed
   values count.

Limitations: two modes within one step that are narrower than it, or a law that moves a mode by many
of its widths without damping it, away from the lines, so that it hardly shows on any of them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hapticd.core.arrays import Complexes, Floats, Integers
from hapticd.model.loop import port_states
from hapticd.model.model import Model

__all__ = ["unresolved_hz"]

# --- angles and the minimum between them ----------------------------------------------------------

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


# --- narrow dips between lines --------------------------------------------------------------------

At = Callable[[Integers, Floats], Complexes]  # Z (n,) of environments (n,) at their own frequencies

_WIDTHS = np.array([-10.0, -3.0, -1.0, -0.3, 0.3, 1.0, 3.0, 10.0])  # undamped, a mode has no Z at 0
_LEAST_SHARE = 1e-4  # of its frequency: a half-width that is less counts as that
_ROUNDS = 2
_DIPS = 3
_WORTH = 5e-4  # of the minimum Re Z: a smaller dip is not followed
_WORTH_NS_PER_M = 1e-5


@dataclass(frozen=True, eq=False)
class MinimumRealPart:
    """Minima of N environments."""

    margin: Floats  # (N,) minimum Re Z, N s/m
    angle: Floats  # (N,) minimum 90 - |phase|, deg
    hz: Floats  # (N,) where Re Z is minimal


def mode_lines(model: Model, active_damping_ns_per_m: float, grid_hz: Floats) -> Floats:
    """Return frequencies (L,) [Hz] around the modes of `model` that are narrower than a step of
    `grid_hz` (F,).
    """
    poles = _poles(model, active_damping_ns_per_m, float(grid_hz[-1]))
    centre = np.abs(poles.imag) / (2.0 * np.pi)
    half = np.abs(poles.real) / (2.0 * np.pi)
    place = np.clip(np.searchsorted(grid_hz, centre), 1, grid_hz.size - 1)
    step = grid_hz[place] - grid_hz[place - 1]
    narrow = (centre > grid_hz[0]) & (centre < grid_hz[-1]) & (half < step)
    away = _WIDTHS * np.maximum(half, _LEAST_SHARE * centre)[narrow, None]
    lines = (centre[narrow, None] + away)[np.abs(away) < step[narrow, None]]
    return np.unique(lines[(lines > grid_hz[0]) & (lines < grid_hz[-1])])


def _poles(model: Model, active_damping_ns_per_m: float, top_hz: float) -> Complexes:
    """Return the poles [rad/s] of the device with its probe held still, and of the free one with
    its aliases up to `top_hz`.
    """
    free = np.linalg.eigvals(model.a(active_damping_ns_per_m))
    reach = int((np.abs(free.imag).max() / (2.0 * np.pi) + top_hz) / model.rate_hz) + 1
    turns = 2j * np.pi * model.rate_hz * np.arange(-reach, reach + 1)
    return np.concatenate(
        (held_poles(model, active_damping_ns_per_m), (free[:, None] + turns).ravel())
    )


def min_real_part(frequency_hz: Floats, z: Complexes, at: At) -> MinimumRealPart:
    """Return minima of Z (N, F) at `frequency_hz` (F,) and between; `at` computes Z anywhere."""
    worst = np.argmin(z.real, axis=1)
    margin = z.real[np.arange(len(z)), worst]
    found = MinimumRealPart(
        margin, 90.0 - np.degrees(np.abs(np.angle(z)).max(axis=1)), frequency_hz[worst]
    )
    if frequency_hz.size > 2:
        _follow(found, frequency_hz, z, at)
    return found


def _follow(found: MinimumRealPart, f: Floats, z: Complexes, at: At) -> None:
    """Lower `found` where a dip is expected between lines: the deepest first."""
    three = np.stack((f[:-2], f[1:-1], f[2:]))
    _, expected = min_between_lines(three, np.stack((z[:, :-2], z[:, 1:-1], z[:, 2:])))
    for _ in range(_DIPS):
        column = np.argmin(expected, axis=1)
        deepest = expected[np.arange(len(z)), column]
        which = np.flatnonzero(deepest < found.margin - _worth(found.margin))
        if not which.size:
            return
        lines = column[which, None] + np.arange(3)
        _descend(found, which, f[lines], z[which[:, None], lines], at)
        expected[which, column[which]] = np.inf


def _worth(margin: Floats) -> Floats:
    """Return how much (N,) [N s/m] deeper a followed dip must be; 0 if it would change the sign."""
    least = np.maximum(_WORTH_NS_PER_M, _WORTH * np.abs(margin))
    return np.where(margin > 0.0, np.minimum(least, margin), least)


def _descend(found: MinimumRealPart, which: Integers, f: Floats, z: Complexes, at: At) -> None:
    """Compute the dips of environments `which` (n,) between lines `f` (n, 3), and again inside."""
    for _ in range(_ROUNDS):
        x, _ = min_between_lines(f.T, z.T)
        going = np.isfinite(x) & ~(f == x[:, None]).any(axis=1)
        which = which[going]
        x = x[going]
        f = f[going]
        z = z[going]
        computed = at(which, x)
        _lower(found, which, x, computed)
        f, z = _around(f, z, x, computed)


def _lower(found: MinimumRealPart, which: Integers, hz: Floats, z: Complexes) -> None:
    found.angle[which] = np.minimum(found.angle[which], 90.0 - np.degrees(np.abs(np.angle(z))))
    lower = z.real < found.margin[which]
    found.margin[which[lower]] = z.real[lower]
    found.hz[which[lower]] = hz[lower]


def _around(three: Floats, values: Complexes, x: Floats, z: Complexes) -> tuple[Floats, Complexes]:
    """The lowest of four lines with its neighbours, (n, 3)."""
    f = np.column_stack((three, x))
    all_z = np.column_stack((values, z))
    order = np.argsort(f, axis=1)
    f = np.take_along_axis(f, order, 1)
    all_z = np.take_along_axis(all_z, order, 1)
    first = np.clip(np.argmin(all_z.real, axis=1), 1, 2)[:, None] - 1 + np.arange(3)
    return np.take_along_axis(f, first, 1), np.take_along_axis(all_z, first, 1)


def min_between_lines(f: Floats, z: Complexes) -> tuple[Floats, Floats]:
    """Return where [Hz] the real part of the single pole through three values is minimal, and that
    minimum.

    `f` (3, ...), ascending, and `z` (3, ...); inf and inf if it is not between the outer two. From
    the middle one, Z = e + w / (d + x): the pole is at x = -d, and the minimum real part of w / (d
    + x) is (s Im w - |w|) / (2 |Im d|) with s the sign of Im d: a line maps to a circle through 0.
    """
    below = f[1] - f[0]
    above = f[2] - f[1]
    before = (z[1] - z[0]) / below
    after = (z[2] - z[1]) / above
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        d = (z[2] - z[0]) / (before - after)
        part = -after * (above + d)
        w = part * d
        size = np.sqrt(w.real**2 + w.imag**2)
        turned = np.copysign(1.0, d.imag) * w.imag
        away = np.abs(d.imag)
        x = -away * w.real / (size - turned) - d.real
        least = z[1].real - part.real + (turned - size) / (2.0 * away)
        between = (x > -below) & (x < above)
    return np.where(between, f[1] + x, np.inf), np.where(between, least, np.inf)
