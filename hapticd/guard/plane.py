"""The K-B plane of a device: the range of B at which each K is stable in every passive hand.

A plane has one virtual mass, one pair of filters and one level of active damping.

The basis of the guard (`bases`) judges a grid of K and B, so a picture of the plane agrees with the
guard's verdicts. For each K the safe values of B are taken as one interval, the longest run. The
set of the theorem is convex for a rigid device. At one delay it was an interval in B for all
devices that were examined.

Limitations: an interval of B narrower than a step of the grid is not found.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hapticd.core.arrays import Flags, Floats
from hapticd.core.environment import Environment
from hapticd.core.params import EnvironmentLimits
from hapticd.guard.safe_region import SafeRegion

_COLUMNS = 60  # values of K
_ROWS = 41  # values of B
_HALVINGS = 5  # of a step of B, towards an edge
_ROOM = 1.25  # length of the axes relative to the safe set and to the environment in force


def plane(
    region: SafeRegion, environment: Environment, level_on: float, most_k: float, most_b: float
) -> dict[str, Any]:
    """Return the edges of the safe B over K, without active damping and with `level_on` [N s/m].

    {K: [..], without: {level, low, high}, with: {level, low, high}, B: [lowest, highest of the
    axis]}; `low` and `high` contain None where no B is safe. `most_k` [N/m] and `most_b` [N s/m]
    bound the axes.
    """
    stiffness, damping = _axes(region, environment, level_on, most_k, most_b)
    found = {
        name: {"level": level, **_edges(region, environment, level, stiffness, damping)}
        for name, level in (("without", 0.0), ("with", level_on))
    }
    return {"K": stiffness.tolist(), "B": [float(damping[0]), float(damping[-1])], **found}


def _axes(
    region: SafeRegion, environment: Environment, level_on: float, most_k: float, most_b: float
) -> tuple[Floats, Floats]:
    """Return K from 0 and B around 0, with the safe set and the environment in force inside."""
    free = replace(
        environment,
        stiffness_n_per_m=0.0,
        virtual_damping_ns_per_m=0.0,
        active_damping_ns_per_m=level_on,
    )
    mass_kg = environment.mass_kg
    limits = EnvironmentLimits((0.0, -most_b, mass_kg), (most_k, most_b, mass_kg))
    alone = region.allowed(free, limits)
    low, high = alone["B"] or [-1.0, 1.0]
    middle = replace(free, virtual_damping_ns_per_m=0.5 * (low + high))
    farthest = max(_end(alone["K"]), _end(region.allowed(middle, limits)["K"]), 1.0)
    stiffest = _ROOM * max(farthest, min(environment.stiffness_n_per_m, 4.0 * farthest))
    reach = _ROOM * max(
        -low, high, min(abs(environment.virtual_damping_ns_per_m), 4.0 * max(-low, high))
    )
    bottom = max(-reach, 2.0 * min(low, environment.virtual_damping_ns_per_m, -0.1 * reach))
    return np.linspace(0.0, stiffest, _COLUMNS), np.linspace(bottom, reach, _ROWS)


def _end(interval: list[float] | None) -> float:
    return interval[1] if interval else 0.0


def _edges(
    region: SafeRegion, environment: Environment, level: float, stiffness: Floats, damping: Floats
) -> dict[str, list[float | None]]:
    damped = replace(environment, active_damping_ns_per_m=level)

    def safe(at_k: Floats, at_b: Floats) -> Flags:
        points = np.column_stack((at_k, at_b, np.full(len(at_k), environment.mass_kg)))
        flags = np.ones(len(points), np.bool_)
        for at in region.conditions(damped):
            flags &= region.basis.safe(points, at)
        return flags

    grid = safe(np.repeat(stiffness, len(damping)), np.tile(damping, len(stiffness)))
    runs = [_longest(row) for row in grid.reshape(len(stiffness), -1)]
    edges: dict[str, list[float | None]] = {}
    for name, end, step in (("low", 0, -1), ("high", 1, 1)):
        known = [column for column, run in enumerate(runs) if run is not None]
        inside = np.array([(runs[column] or (0, 0))[end] for column in known], np.int64)
        outside = np.clip(inside + step, 0, len(damping) - 1)
        values = _bisected(safe, stiffness[known], damping[inside], damping[outside])
        edges[name] = [None] * len(stiffness)
        for column, value in zip(known, values.tolist(), strict=True):
            edges[name][column] = value
    return edges


def _bisected(
    safe: Callable[[Floats, Floats], Flags], stiffness: Floats, inside: Floats, outside: Floats
) -> Floats:
    """Return the last safe B between a safe and an unsafe one, for each K (n,)."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (inside + outside)
        held = safe(stiffness, middle)
        inside = np.where(held, middle, inside)
        outside = np.where(held, outside, middle)
    return inside


def _longest(safe: Flags) -> tuple[int, int] | None:
    """Return the first and last index of the longest run of true flags; None without any."""
    held = np.flatnonzero(safe)
    if not held.size:
        return None
    runs = np.split(held, np.flatnonzero(np.diff(held) > 1) + 1)
    longest = max(runs, key=len)
    return int(longest[0]), int(longest[-1])
