"""Slices through what a directed search found: the largest passive K over B at one M, beside what was predicted before it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Flags, Floats
from hapticd.analysis.search import predicted_passive
from hapticd.analysis.surrogate import Box
from hapticd.measure.directed import SearchResult
from hapticd.measure.outcomes import predictor

GRID = (30, 80)  # of K and B
_HALVINGS = 7


@dataclass(frozen=True, eq=False)
class Slice:
    """Largest K (nB,) at each `damping` (nB,) of a plane of one M, as the search holds it and as `predicted` before any trial."""

    mass_kg: float
    damping: Floats
    held: Floats
    predicted: Floats


def slice_at(result: SearchResult, mass_kg: float) -> Slice:
    """The plane of one M through the box: what the search holds, and what was predicted before any trial."""
    params, box = result.plan.params, result.plan.box
    guess = predictor(params.conditions, params.damping_ns_per_m)
    damping = np.linspace(box.low[1], box.high[1], GRID[1])
    held = _highest(lambda points: predicted_passive(result.search, points), box, damping, mass_kg)
    return Slice(mass_kg, damping, held, _highest(lambda points: guess(points).passive, box, damping, mass_kg))


def _highest(holds: Callable[[Floats], Flags], box: Box, damping: Floats, mass_kg: float) -> Floats:
    """Largest K (nB,) that holds at each damping, nan where none does: on a grid, then halved to 1 % of its step."""
    k = np.linspace(box.low[0], box.high[0], GRID[0])
    held = holds(np.array([(stiffness, b, mass_kg) for stiffness in k for b in damping])).reshape(k.size, damping.size)
    top = k.size - 1 - np.argmax(held[::-1], axis=0)
    low, high = k[top], k[np.minimum(top + 1, k.size - 1)]
    for _ in range(_HALVINGS):
        half = 0.5 * (low + high)
        inside = holds(np.column_stack((half, damping, np.full(damping.size, mass_kg))))
        low, high = np.where(inside, half, low), np.where(inside, high, half)
    return np.where(held.any(axis=0), low, np.nan)
