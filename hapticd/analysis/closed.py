"""Is the sampled loop stable? The exact map of one tick, device, delay and filters together, and
its spectral radius.

Its state is the device's, the commands on their way, the two last positions and the filters'. It is
affine in (K, B, M): the law is one row that is added through one column. With K = 0 nothing holds
the device in place; translation of everything together is an eigenvector with eigenvalue 1 and is
left out, once. Below 1 everything else dies out.

What would break it: judging by the growth of a 90 s record; at K = 2,000 N/m a radius of 1.00002
takes half a minute to show.
"""

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.loop import PAPER_FILTERS, Filters, Sampled, biquad_of, sampled
from hapticd.plant.model import Model
from hapticd.render.filters import Biquad


def spectral_radius(
    model: Model, points: Floats, damping_ns_per_m: float = 0.0, filters: Filters = PAPER_FILTERS
) -> Floats:
    """Largest |eigenvalue| (N,) of one tick of `model` under the environments `points` (N, 3):
    K, B, M in SI.
    """
    kbm = np.atleast_2d(np.asarray(points, np.float64))
    base, column, rows = _tick(sampled(model, damping_ns_per_m), model.rate_hz, filters)
    matrices = base - column[:, None] * (kbm @ rows)[:, None, :]
    values = np.linalg.eigvals(matrices)
    free = (kbm[:, 0] == 0.0) & _drifts(model, damping_ns_per_m)
    nearest = np.argmin(np.abs(values[free] - 1.0), axis=1)
    values[np.flatnonzero(free), nearest] = 0.0
    return np.asarray(np.abs(values).max(axis=1))


def _drifts(model: Model, damping_ns_per_m: float) -> bool:
    """Whether nothing in the device itself holds it in place."""
    shift = np.array([1.0 if state.name.endswith("_position") else 0.0 for state in model.states])
    return not bool((model.a(damping_ns_per_m) @ shift).any())


def _tick(device: Sampled, rate_hz: float, filters: Filters) -> tuple[Floats, Floats, Floats]:
    """(matrix without law, column through which the command enters, rows (3, n) of position,
    velocity and acceleration).
    """
    n = len(device.a)
    waiting = device.steps + 1
    size = n + waiting + 6
    unit = np.eye(size)
    base = np.zeros((size, size))
    column = np.zeros(size)
    base[:n, :n] = device.a
    if device.steps:
        base[:n, n + device.steps - 1] += device.new
    else:
        column[:n] = device.new
    base[:n, n + device.steps] += device.old
    column[n] = 1.0
    base[n + 1 : n + waiting, n : n + waiting - 1] = np.eye(waiting - 1)
    at = n + waiting
    position = np.concatenate((device.row, np.zeros(size - n)))
    slope = (position - unit[at]) * rate_hz
    bend = (position - 2.0 * unit[at] + unit[at + 1]) * rate_hz**2
    base[at], base[at + 1] = position, unit[at]
    velocity = _filter(base, unit, at + 2, slope, biquad_of(filters[0], rate_hz))
    acceleration = _filter(base, unit, at + 4, bend, biquad_of(filters[1], rate_hz))
    return base, column, np.stack((position, velocity, acceleration))


def _filter(base: Floats, unit: Floats, at: int, source: Floats, biquad: Biquad) -> Floats:
    """Write a filter's two states into `base`; the row of its output."""
    b0, b1, b2, a1, a2 = biquad
    out = b0 * source + unit[at]
    base[at] = b1 * source - a1 * out + unit[at + 1]
    base[at + 1] = b2 * source - a2 * out
    return np.asarray(out)
