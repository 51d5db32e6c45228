"""A grid twice as fine: where its points lie, which of them need a trial, and what the others take from their neighbours.

A trial is made in the middle of two neighbours along an axis whose answers are unlike: one passes, the other does not. Every
other new point gets the mean of its neighbours' margins, so where both pass it passes too. That is the same linear margin between
corners that counts volumes (`analysis.boundary`).

What would break it: a hole in the set that is smaller than a cell; no finer grid finds it where coarse neighbours agree.
"""

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.boundary import PassiveSet
from hapticd.measure.lots import Point


def between(found: PassiveSet) -> list[Point]:
    """Midpoints (K, B, M) [N/m, N s/m, kg] of neighbours along an axis of unlike answers."""
    cube = np.stack(np.meshgrid(*found.axes, indexing="ij"), axis=-1)
    middles: list[Point] = []
    for place in range(3):
        low, high = [slice(None)] * 3, [slice(None)] * 3
        low[place], high[place] = slice(None, -1), slice(1, None)
        unlike = found.passive[tuple(low)] != found.passive[tuple(high)]
        rows = 0.5 * (cube[tuple(low)] + cube[tuple(high)])[unlike]
        middles += [(float(k), float(b), float(m)) for k, b, m in rows]
    return middles


def halved(found: PassiveSet) -> PassiveSet:
    """On the finer grid: means between neighbours; nan, which is not passive, beside a nan."""
    margin = found.margin
    for place in range(3):
        margin = np.apply_along_axis(_with_means, place, margin)
    k, b, m = (_with_means(axis) for axis in found.axes)
    return PassiveSet((k, b, m), margin)


def place_of(found: PassiveSet, point: Point) -> tuple[int, ...]:
    """Indices of a point of the grid."""
    return tuple(int(np.searchsorted(axis, value)) for axis, value in zip(found.axes, point, strict=True))


def _with_means(values: Floats) -> Floats:
    finer = np.repeat(values, 2)[:-1]
    finer[1::2] = 0.5 * (values[1:] + values[:-1])
    return np.asarray(finer)
