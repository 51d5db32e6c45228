"""A map of the passive set: a grid of K, B and M, at any damping levels, as the paper's 13 days of trials, but thriftier.

Everything is predicted first, in about a second. Trials are made where the prediction may be wrong: where it changes when the
environment is scaled by 1 -+ `near` (15 %), and at grid points whose neighbour is predicted otherwise. The rest keeps its
prediction, marked so; `everywhere` makes every trial, there with one sub-step, which is enough to tell what is far from the
boundary. `refine` then halves the grid between neighbours of unlike answers.

Outcomes go to an append-only store, keyed by all that they depend on; a map that was interrupted, or is asked again with a
wider grid, makes only the trials that are missing. Tasks run on any executor of concurrent.futures; results do not depend on it.

What would break it: a device whose prediction is off by more than `near` (the limits say by how much it is); then `everywhere`.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, as_completed
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hapticd.analysis.arrays import Flags, Floats
from hapticd.analysis.boundary import PassiveSet, grid, passive_set
from hapticd.analysis.envelope import Envelope
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.predict import Prediction, predict
from hapticd.measure.executors import threads
from hapticd.measure.outcomes import TOGETHER, Conditions, Outcome, envelope_of, fly, kept, key_of, restored
from hapticd.measure.progress import Progress, silent
from hapticd.measure.scenes import filters
from hapticd.measure.store import TrialStore, fingerprint
from hapticd.plant.compose import compose

Axes = tuple[Floats, Floats, Floats]
Point = tuple[float, float, float]
Keep = Callable[[list[Outcome]], None]
NEAR = 0.15


@dataclass(frozen=True, eq=False)
class MapParams:
    """`axes`: ascending K [N/m], B [Ns/m], M [kg]; `levels` of damping [Ns/m]."""

    conditions: Conditions
    axes: Axes
    levels: tuple[float, ...] = (0.0, 1.74)
    near: float = NEAR
    everywhere: bool = False
    refine: int = 0


@dataclass(frozen=True, eq=False)
class LevelPlan:
    """One damping level: the whole grid's prediction, and which points (N,) are near its boundary."""

    damping_ns_per_m: float
    prediction: Prediction
    near: Flags


@dataclass(frozen=True, eq=False)
class MapPlan:
    """What will be tried."""

    params: MapParams
    levels: tuple[LevelPlan, ...]

    @property
    def trials(self) -> int:
        """Without refinement, and if the store had none."""
        return sum(level.near.size if self.params.everywhere else int(level.near.sum()) for level in self.levels)


@dataclass(frozen=True, eq=False)
class LevelMap:
    """The set at one level; `tried` (N,) tells points with a trial from predicted ones, `envelope` is None if no trial passed."""

    damping_ns_per_m: float
    found: PassiveSet
    tried: Flags
    outcomes: tuple[Outcome, ...]
    envelope: Envelope | None
    disagreements: int  # trials that came out unlike their prediction


@dataclass(frozen=True, eq=False)
class MapResult:
    """One map a level. `made` trials were new, the rest came from the store."""

    plan: MapPlan
    levels: tuple[LevelMap, ...]
    made: int


def plan_map(params: MapParams) -> MapPlan:
    """Predict the grid and choose. ConfigError as `compose`."""
    model, source = compose(params.conditions.scene), params.conditions.excitation
    perturbation = Perturbation(source.psd_n2_per_hz, source.band_hz)
    chosen, points = filters(params.conditions.scene), grid(params.axes)

    def guess(level: float, where: Floats) -> Prediction:
        return predict(model, where, level, chosen, perturbation, params.conditions.band_hz, recorded=True)

    plans = []
    for level in params.levels:
        here = guess(level, points)
        scaled = [guess(level, factor * points).passive for factor in (1.0 - params.near, 1.0 + params.near)]
        near = (scaled[0] != here.passive) | (scaled[1] != here.passive) | _at_border(params.axes, here.passive)
        plans.append(LevelPlan(level, here, near))
    return MapPlan(params, tuple(plans))


def run_map(
    plan: MapPlan, store: TrialStore, tell: Progress = silent, executor: Executor | None = None, redraw: Keep = lambda new: None
) -> MapResult:
    """Make the trials that the store has not; `redraw` hears of all outcomes so far after each task.

    KeyboardInterrupt passes through after the tasks in flight were given up; what was finished is in the store.
    """
    made, levels = 0, []
    with threads() if executor is None else nullcontext(executor) as pool:
        for level in plan.levels:
            lots, have = _lots(plan.params, level), list[Outcome]()
            for finer in range(plan.params.refine + 1):
                lots[0] = lots[0].with_points(_between(plan.params.axes, have) if finer else [])
                made += sum([_make(lot, store, tell, pool, redraw) for lot in lots])
                have = [outcome for lot in lots for outcome in _known(lot, store)]
            levels.append(_level_map(plan.params, level, have))
    return MapResult(plan, tuple(levels), made)


@dataclass(frozen=True, eq=False)
class _Lot:
    """Trials under one set of conditions."""

    conditions: Conditions
    damping_ns_per_m: float
    points: tuple[Point, ...]

    def with_points(self, more: list[Point]) -> "_Lot":
        """With those that it does not have yet."""
        return replace(self, points=tuple(dict.fromkeys((*self.points, *more))))

    @cached_property
    def keys(self) -> dict[Point, str]:
        """Of each point in a store."""
        shared = fingerprint(self.conditions)
        return {point: key_of(self.conditions, shared, self.damping_ns_per_m, point) for point in self.points}


def _lots(params: MapParams, level: LevelPlan) -> list[_Lot]:
    """Near the boundary with the conditions that are asked for, elsewhere with one sub-step."""
    conditions, points = params.conditions, level.prediction.points
    lots = [_Lot(conditions, level.damping_ns_per_m, _points(points[level.near]))]
    if params.everywhere:
        lots.append(_Lot(replace(conditions, substeps=1), level.damping_ns_per_m, _points(points[~level.near])))
    return lots


def _points(rows: Floats) -> tuple[Point, ...]:
    return tuple((float(k), float(b), float(m)) for k, b, m in rows)


def _make(lot: _Lot, store: TrialStore, tell: Progress, pool: Executor, redraw: Keep) -> int:
    missing = [point for point, key in lot.keys.items() if key not in store.known]
    tasks = [np.array(missing[first : first + TOGETHER]) for first in range(0, len(missing), TOGETHER)]
    done, what = len(lot.points) - len(missing), f"trials, added damping {lot.damping_ns_per_m:g} N s/m"
    tell(what, done, len(lot.points))
    for outcomes in _flown(lot, tasks, pool):
        store.add((lot.keys[outcome.environment], kept(outcome)) for outcome in outcomes)
        done += len(outcomes)
        tell(what, done, len(lot.points))
        redraw(outcomes)
    return len(missing)


def _flown(lot: _Lot, tasks: list[Floats], pool: Executor) -> Iterator[list[Outcome]]:
    """Outcomes of tasks as they finish; what has not begun is given up when the caller stops."""
    waiting: list[Future[list[Outcome]]] = [pool.submit(fly, lot.conditions, lot.damping_ns_per_m, task) for task in tasks]
    try:
        for future in as_completed(waiting):
            yield future.result()
    finally:
        for future in waiting:
            future.cancel()


def _known(lot: _Lot, store: TrialStore) -> list[Outcome]:
    return [restored(store.known[key]) for key in lot.keys.values()]


def _at_border(axes: Axes, passive: Flags) -> Flags:
    """(N,) points with a neighbour along an axis that is predicted otherwise."""
    cube = passive.reshape([axis.size for axis in axes])
    found = np.zeros_like(cube)
    for place in range(3):
        unlike = np.diff(cube.astype(np.int8), axis=place) != 0
        behind, ahead = [slice(None)] * 3, [slice(None)] * 3
        behind[place], ahead[place] = slice(None, -1), slice(1, None)
        found[tuple(behind)] |= unlike
        found[tuple(ahead)] |= unlike
    return found.ravel()


def _between(axes: Axes, outcomes: list[Outcome]) -> list[Point]:
    """Midpoints between tried grid neighbours of unlike answers."""
    passed = {outcome.environment: outcome.passes for outcome in outcomes}
    middles = []
    for point, good in passed.items():
        for place, axis in enumerate(axes):
            at = int(np.searchsorted(axis, point[place]))
            if at + 1 >= axis.size or axis[at] != point[place]:
                continue
            if passed.get(_moved(point, place, float(axis[at + 1])), good) != good:
                middles.append(_moved(point, place, 0.5 * (point[place] + float(axis[at + 1]))))
    return middles


def _moved(point: Point, place: int, value: float) -> Point:
    k, b, m = (value if index == place else old for index, old in enumerate(point))
    return k, b, m


def _level_map(params: MapParams, level: LevelPlan, outcomes: list[Outcome]) -> LevelMap:
    margin, tried = level.prediction.decided_margin.copy(), np.zeros(len(level.near), bool)
    place = {tuple(point): index for index, point in enumerate(level.prediction.points.tolist())}
    unlike = 0
    for outcome in outcomes:
        index = place.get(outcome.environment)
        if index is None:
            continue
        tried[index] = True
        unlike += bool(level.prediction.passive[index]) != outcome.passes
        value = outcome.margin_ns_per_m
        margin[index] = abs(value) if outcome.passes else -abs(value) if np.isfinite(value) else np.nan
    passing = [outcome for outcome in outcomes if outcome.passes]
    envelope = envelope_of(passing) if passing else None
    return LevelMap(level.damping_ns_per_m, passive_set(params.axes, margin), tried, tuple(outcomes), envelope, unlike)
