"""A map of the passive set: a grid of K, B and M, at any damping levels, as the paper's 13 days of trials, but thriftier.

Everything is predicted first, in about a second. Trials are made where the prediction may be wrong: where it changes when the
environment is scaled by 1 -+ `near` (15 %), and at grid points whose neighbour is predicted otherwise. The rest keeps its
prediction, marked so; `everywhere` makes every trial, there with one sub-step, which is enough to tell what is far from the
boundary. `refine` then halves the grid: trials are made between neighbours of unlike answers; other new points take what lies
between their neighbours, so an answer that both share is theirs as well.

Outcomes go to an append-only store, keyed by all that they depend on; a map that was interrupted, or is asked again with a
wider grid, makes only the trials that are missing. Tasks run on any executor of concurrent.futures; results do not depend on it.

What would break it: a device whose prediction is off by more than `near` (the limits say by how much it is); then `everywhere`.
"""

from concurrent.futures import Executor
from dataclasses import dataclass, replace
from math import prod

import numpy as np

from hapticd.analysis.arrays import Flags, Floats
from hapticd.analysis.boundary import PassiveSet, ascending, grid, passive_set
from hapticd.analysis.envelope import Envelope
from hapticd.analysis.predict import Prediction
from hapticd.errors import AnalysisError
from hapticd.measure.executors import pool_of
from hapticd.measure.lots import Lot, Point, make
from hapticd.measure.outcomes import Conditions, Hear, Outcome, envelope_of, predictor
from hapticd.measure.progress import Progress, silent
from hapticd.measure.refining import between, halved, place_of
from hapticd.measure.store import TrialStore

Axes = tuple[Floats, Floats, Floats]
NEAR = 0.15
MOST = 10_000_000  # environments of a grid: half an hour of prediction, and a GB


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
    """The set at one level, on the halved grid if it was refined; `tried` (N,) tells its points with a trial from others.

    `envelope` is None if no trial passed.
    """

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
    """Predict the grid and choose. AnalysisError for axes that do not ascend or are too many points; ConfigError as `compose`."""
    ascending(params.axes)
    if (count := prod(axis.size for axis in params.axes)) > MOST:
        raise AnalysisError(f"a grid of {count} environments: {MOST} at most; refine it about the boundary instead")
    points, plans = grid(params.axes), []
    for level in params.levels:
        guess = predictor(params.conditions, level)
        here = guess(points)
        scaled = [guess(factor * points).passive for factor in (1.0 - params.near, 1.0 + params.near)]
        near = (scaled[0] != here.passive) | (scaled[1] != here.passive) | _at_border(params.axes, here.passive)
        plans.append(LevelPlan(level, here, near))
    return MapPlan(params, tuple(plans))


def run_map(
    plan: MapPlan, store: TrialStore, tell: Progress = silent, executor: Executor | None = None, hear: Hear = lambda new: None
) -> MapResult:
    """Make the trials that the store has not; `hear` gets the outcomes of each task.

    KeyboardInterrupt passes through after the tasks in flight were given up; what was finished is in the store.
    """
    made, levels = 0, []
    with pool_of(executor) as pool:
        for level in plan.levels:
            lots, found = _lots(plan.params, level), passive_set(plan.params.axes, level.prediction.decided_margin)
            for finer in range(plan.params.refine + 1):
                if finer:
                    lots[0], found = lots[0].with_points(between(found)), halved(found)
                made += sum([make(lot, store, tell, pool, hear) for lot in lots])
                have = [outcome for lot in lots for outcome in lot.known(store)]
                found = _learnt(found, have)
            levels.append(_level_map(plan.params, level, found, have))
    return MapResult(plan, tuple(levels), made)


def _lots(params: MapParams, level: LevelPlan) -> list[Lot]:
    """Near the boundary with the conditions that are asked for, elsewhere with one sub-step."""
    conditions, points = params.conditions, level.prediction.points
    lots = [Lot(conditions, level.damping_ns_per_m, _points(points[level.near]))]
    if params.everywhere:
        lots.append(Lot(replace(conditions, substeps=1), level.damping_ns_per_m, _points(points[~level.near])))
    return lots


def _points(rows: Floats) -> tuple[Point, ...]:
    return tuple((float(k), float(b), float(m)) for k, b, m in rows)


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


def _learnt(found: PassiveSet, outcomes: list[Outcome]) -> PassiveSet:
    """With the margins of trials: negative where one does not pass, nan where it escapes."""
    margin = found.margin.copy()
    for outcome in outcomes:
        value = abs(outcome.margin_ns_per_m)
        margin[place_of(found, outcome.environment)] = value if outcome.passes else -value if np.isfinite(value) else np.nan
    return replace(found, margin=margin)


def _level_map(params: MapParams, level: LevelPlan, found: PassiveSet, outcomes: list[Outcome]) -> LevelMap:
    tried = np.zeros(found.margin.shape, bool)
    for outcome in outcomes:
        tried[place_of(found, outcome.environment)] = True
    passing = [outcome for outcome in outcomes if outcome.passes]
    envelope = envelope_of(passing) if passing else None
    unlike = _unlike(params, level, outcomes)
    return LevelMap(level.damping_ns_per_m, found, tried.ravel(), tuple(outcomes), envelope, unlike)


def _unlike(params: MapParams, level: LevelPlan, outcomes: list[Outcome]) -> int:
    """Trials that came out unlike their prediction; those between the points of the plan are predicted here."""
    expected = dict(zip(_points(level.prediction.points), level.prediction.passive, strict=True))
    new = [outcome.environment for outcome in outcomes if outcome.environment not in expected]
    if new:
        guess = predictor(params.conditions, level.damping_ns_per_m)(np.array(new))
        expected |= dict(zip(new, guess.passive, strict=True))
    return sum(bool(expected[outcome.environment]) != outcome.passes for outcome in outcomes)
