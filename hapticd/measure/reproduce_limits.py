"""How far K, B and M go on the paper's device: predicted, then by trials around the prediction, for each seed of the noise.

Two readings. Axis: the other two are 0, as the paper's numbers are understood here. Set: the largest over all passive K, B, M; its
place is predicted, then only the parameter itself is searched by trials, from 0 at the predicted best values of the others.

What would break it: a set that is not in one piece along the line that is searched; the first failure counts.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from hapticd.analysis.arrays import Flags, Floats
from hapticd.analysis.boundary import axis_limit, grid
from hapticd.measure.reproduce_trials import EDGES_HZ, TOGETHER, Point, Subject, decided, flown, subject

NAMES = ("K_max", "B_max", "M_min")
REACH = (2e4, 50.0, -0.2)
UNITS = ("N/m", "Ns/m", "kg")
TIMES = (1.5, 4.0)  # the predicted limit: of a search by trials
EDGE_STEPS = 80
EDGE_TIMES = 2.0
SET_GRID = (np.arange(31) * 50.0, np.arange(19) * 0.5, np.arange(-10, 11) * 0.0025)

Decide = Callable[[Floats], Flags]


@dataclass(frozen=True, eq=False)
class Limit:
    """Limit of one parameter: `values` (seeds,) by trials, empty without; 0, and nan in `predicted`, where nothing is passive."""

    device: str
    level: float
    axis: int
    base: Point
    predicted: float
    values: Floats

    @property
    def mean(self) -> float:
        """Over seeds; the prediction without trials; 0 where nothing is passive."""
        return float(np.nan_to_num(self.values.mean() if self.values.size else self.predicted))

    @property
    def sd(self) -> float:
        """Over seeds; nan with less than two."""
        return float(self.values.std(ddof=1)) if self.values.size > 1 else float("nan")


def predicted_limit(device: str, level: float, axis: int, base: Point = (0.0, 0.0, 0.0)) -> float:
    """The first failure by prediction; nan where even K = B = M = 0 is not passive."""
    own = subject(device)
    return axis_limit(lambda points: own.passive(points, level), axis, REACH[axis], base)


def simulated_limit(device: str, level: float, axis: int, base: Point, near: float, seed: int) -> float:
    """By trials with the noise of `seed`, TOGETHER a round; nan where `base` fails or nothing is predicted (`near`)."""
    if not np.isfinite(near):
        return float("nan")
    own, found = subject(device), float("nan")
    for times in TIMES:
        found = axis_limit(partial(_decide, own, level, seed), axis, times * near, base, steps=TOGETHER - 1)
        if found != base[axis] + times * near:
            break
    return found


def _decide(device: Subject, level: float, seed: int, points: Floats) -> Flags:
    return decided(flown(device, points, level, seed))


def edge_step(near: float) -> float:
    """Between two trials of that scan [N/m]; a limit is known to it."""
    return near * EDGE_TIMES / EDGE_STEPS


def edge_limits(device: str, level: float, near: float, seed: int) -> Floats:
    """K limits [N/m] (EDGES_HZ,) on the axis, by one scan whose trials are judged from each lower band edge; nan without `near`."""
    if not np.isfinite(near):
        return np.full(len(EDGES_HZ), np.nan)
    points = np.zeros((EDGE_STEPS, 3))
    points[:, 0] = edge_step(near) * np.arange(1, EDGE_STEPS + 1)
    trials = list(flown(subject(device), points, level, seed))
    return np.array([_last_passive(points[:, 0], decided(trials, edge)) for edge in EDGES_HZ])


def predicted_edge_limits(device: str, level: float) -> Floats:
    """The same by prediction."""
    own = subject(device)

    def limit(edge: float) -> float:
        return axis_limit(lambda points: own.passive(points, level, (edge, 500.0)), 0, REACH[0])

    return np.array([limit(edge) for edge in EDGES_HZ])


def _last_passive(values: Floats, passive: Flags) -> float:
    """The value before the first failure, half a step up; 0 if the first fails."""
    failed = np.flatnonzero(~passive)
    if not failed.size:
        return float(values[-1])
    return float(values[failed[0]] - 0.5 * values[0]) if failed[0] else 0.0


def set_place(device: str, level: float, axis: int) -> Point | None:
    """Where the set reading of a parameter is searched from: the others at their predicted best, itself 0; None if none is."""
    kept = _predicted_set(device, level)
    if not len(kept):
        return None
    extreme = kept[:, axis].max() if axis < 2 else kept[:, axis].min()
    best = np.median(kept[kept[:, axis] == extreme], axis=0)
    best[axis] = 0.0
    return float(best[0]), float(best[1]), float(best[2])


@cache
def _predicted_set(device: str, level: float) -> Floats:
    points = grid(SET_GRID)
    return np.asarray(points[subject(device).passive(points, level)])
