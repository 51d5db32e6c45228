"""A map of the passive set: a grid of K, B and M at any damping levels, as in the paper's 13 days
of trials, with fewer trials.

The whole grid is predicted first, in about a second. Trials run where the prediction may be wrong:
where it changes when the environment is scaled by 1 -+ `near` (15 %), and at grid points with a
neighbour of the opposite prediction. The rest keeps its prediction, marked so. `everywhere` runs
every trial, with one sub-step elsewhere, which suffices far from the boundary. `refine` then halves
the grid: a trial runs in the middle of two neighbours along an axis with different answers. Every
other new point gets the mean of its neighbours' margins, so it passes if both pass. That is the
linear margin between corners that also gives volumes (`zwidth.passive_set`).

Outcomes go to an append-only store, keyed by everything that they depend on. If a map is
interrupted, or requested again with a wider grid, only the missing trials run. Tasks run on any
executor of concurrent.futures; results do not depend on it.

Limitations: a device whose prediction is wrong by more than `near` (the limits show its error); use
`everywhere` then. A hole in the set smaller than a cell is not found where the coarse neighbours
agree.
"""

from concurrent.futures import Executor
from dataclasses import dataclass, replace
from math import prod

import numpy as np

from hapticd.core.arrays import Flags, Floats
from hapticd.core.errors import AnalysisError
from hapticd.model.predict import Prediction
from hapticd.signal.verdict import Judged
from hapticd.zwidth.limits import LimitsResult
from hapticd.zwidth.outcomes import (
    Conditions,
    OnOutcomes,
    Outcome,
    Point,
    Procedure,
    TrialBatch,
    envelope_of,
    judged,
    points_of,
    restored,
    run_all,
)
from hapticd.zwidth.passive_set import Envelope, PassiveSet, ascending, grid
from hapticd.zwidth.store import Progress, TrialStore, silent

__all__ = [
    "Axes",
    "LevelMap",
    "MapParams",
    "MapPlan",
    "MapResult",
    "kept_map",
    "params_about",
    "plan_map",
    "run_map",
]

Axes = tuple[Floats, Floats, Floats]
NEAR = 0.15
GRID = (12, 10)  # values of K and of B about the limits of a device
GRID_MARGIN = (2.0, 1.15)  # of that grid over the largest axis limits: K, B
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
    """One damping level: the grid's prediction, and which points (N,) are near its boundary."""

    active_damping_ns_per_m: float
    prediction: Prediction
    near: Flags


@dataclass(frozen=True, eq=False)
class MapPlan:
    """The planned trials."""

    params: MapParams
    levels: tuple[LevelPlan, ...]

    @property
    def trials(self) -> int:
        """Number of trials without refinement and with an empty store."""
        return sum(
            level.near.size if self.params.everywhere else int(level.near.sum())
            for level in self.levels
        )


@dataclass(frozen=True, eq=False)
class LevelMap:
    """The set at one level, on the refined grid if it was refined; `tried` (N,) marks points with a
    trial. `envelope` is None if no trial passed.
    """

    active_damping_ns_per_m: float
    found: PassiveSet
    tried: Flags
    outcomes: tuple[Outcome, ...]
    envelope: Envelope | None
    disagreements: int  # trials that contradict their prediction


@dataclass(frozen=True, eq=False)
class MapResult:
    """One map per level. `made` trials were new, the rest came from the store."""

    plan: MapPlan
    levels: tuple[LevelMap, ...]
    made: int

    @property
    def judged(self) -> Judged:
        """The range of frequencies judged in every trial."""
        return judged(outcome for level in self.levels for outcome in level.outcomes)


def params_about(limits: LimitsResult) -> MapParams:
    """Return a map that contains the `limits` along the axes, at their levels and conditions.
    AnalysisError if K = B = M = 0 is not passive, because there is then no set to map.
    """
    largest = [0.0, 0.0, 0.0]
    for limit in limits.limits:
        axis = limit.scan.axis
        largest[axis] = max(largest[axis], abs(limit.value))
    if not all(np.isfinite(largest)) or min(largest) == 0.0:
        raise AnalysisError(
            "the display is not passive at K = B = M = 0, so there is no set to map; see `hapticd"
            " zwidth trial`"
        )
    axes = (
        np.linspace(0.0, GRID_MARGIN[0] * largest[0], GRID[0]),
        np.linspace(0.0, GRID_MARGIN[1] * largest[1], GRID[1]),
        np.asarray(largest[2] * 0.25 * np.arange(-5, 7)),  # M = 0 is one of them
    )
    return MapParams(limits.plan.params.conditions, axes, limits.plan.params.levels)


def plan_map(params: MapParams) -> MapPlan:
    """Predict the grid and choose the trials. AnalysisError for axes that do not ascend or too many
    points; ConfigError as `compose`.
    """
    ascending(params.axes)
    if (count := prod(axis.size for axis in params.axes)) > MOST:
        raise AnalysisError(
            f"a grid of {count} environments: {MOST} at most; refine it about the boundary instead"
        )
    points = grid(params.axes)
    plans = []
    for level in params.levels:
        here = _predicted(params, level, points)
        scaled = [
            _predicted(params, level, factor * points).passive
            for factor in (1.0 - params.near, 1.0 + params.near)
        ]
        near = (
            (scaled[0] != here.passive)
            | (scaled[1] != here.passive)
            | _at_border(params.axes, here.passive)
        )
        plans.append(LevelPlan(level, here, near))
    return MapPlan(params, tuple(plans))


def run_map(
    plan: MapPlan,
    store: TrialStore,
    tell: Progress = silent,
    executor: Executor | None = None,
    on_outcomes: OnOutcomes = lambda new: None,
) -> MapResult:
    """Run the trials missing from the store; `on_outcomes` receives the new outcomes of each task.

    KeyboardInterrupt propagates after the running tasks were cancelled; finished trials are in the
    store.
    """
    total = plan.trials
    before = len(store.known)

    def on_batch(place: int, batch: TrialBatch, new: list[Outcome]) -> None:
        tell("trials", min(len(store.known) - before, total), total)
        on_outcomes(new)

    tell("trials", 0, total)
    levels = run_all(
        [_mapped(plan.params, level) for level in plan.levels], store, executor, on_batch
    )
    return MapResult(plan, tuple(levels), len(store.known) - before)


def kept_map(plan: MapPlan, store: TrialStore) -> MapResult:
    """Return the map of a finished run, from its stored trials alone: nothing is simulated.

    If the store has trials under other keys only, those of another version, they are matched by
    level and environment.
    """
    every = [restored(line) for line in store.known.values() if "environment" in line]
    matched = [
        {
            one.environment: one
            for one in every
            if one.active_damping_ns_per_m == level.active_damping_ns_per_m
        }
        for level in plan.levels
    ]
    own = [
        _of_its_own(plan.params.conditions, level.active_damping_ns_per_m, tuple(known), store)
        for level, known in zip(plan.levels, matched, strict=True)
    ]
    levels = zip(plan.levels, own if any(own) else matched, strict=True)
    return MapResult(plan, tuple(_of_kept(plan.params, *each) for each in levels), 0)


def _of_its_own(
    conditions: Conditions, level: float, points: tuple[Point, ...], store: TrialStore
) -> dict[Point, Outcome]:
    """Return outcomes at `points` made under these conditions, the finer ones first."""
    batches = [
        TrialBatch(given, level, points) for given in (replace(conditions, substeps=1), conditions)
    ]
    return {
        point: restored(store.known[key])
        for batch in batches
        for point, key in batch.keys.items()
        if key in store.known
    }


def _of_kept(params: MapParams, level: LevelPlan, known: dict[Point, Outcome]) -> LevelMap:
    """Return the map of a level from existing outcomes."""
    search = _mapped(params, replace(level, near=np.ones_like(level.near)))
    batches = next(search)
    while True:
        asked = [point for batch in batches for point in batch.points if point in known]
        try:
            batches = search.send([known[point] for point in asked])
        except StopIteration as end:
            found: LevelMap = end.value
            return found


def _predicted(params: MapParams, level: float, points: Floats) -> Prediction:
    return params.conditions.display.predicted(points, level, params.conditions.band_hz)


def _mapped(params: MapParams, level: LevelPlan) -> Procedure[LevelMap]:
    batches = _batches(params, level)
    found = PassiveSet.of(params.axes, level.prediction.decided_margin)
    have = yield batches
    found = _learnt(found, have)
    for _ in range(params.refine):
        points = dict.fromkeys((*batches[0].points, *between(found)))
        batches[0] = replace(batches[0], points=tuple(points))
        found = halved(found)
        have = yield batches
        found = _learnt(found, have)
    return _level_map(params, level, found, have)


def _batches(params: MapParams, level: LevelPlan) -> list[TrialBatch]:
    """Return trials near the boundary as requested, elsewhere with one sub-step."""
    conditions = params.conditions
    points = level.prediction.points
    batches = [TrialBatch(conditions, level.active_damping_ns_per_m, points_of(points[level.near]))]
    if params.everywhere:
        batches.append(
            TrialBatch(
                replace(conditions, substeps=1),
                level.active_damping_ns_per_m,
                points_of(points[~level.near]),
            )
        )
    return batches


def _at_border(axes: Axes, passive: Flags) -> Flags:
    """Return (N,) points with a neighbour along an axis of the opposite prediction."""
    cube = passive.reshape([axis.size for axis in axes])
    found = np.zeros_like(cube)
    for low, high in map(_neighbours, range(3)):
        unlike = cube[low] != cube[high]
        found[low] |= unlike
        found[high] |= unlike
    return found.ravel()


def _neighbours(place: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Return slices of all points of a grid but the last along an axis, and but the first."""
    low = [slice(None)] * 3
    high = [slice(None)] * 3
    low[place] = slice(None, -1)
    high[place] = slice(1, None)
    return tuple(low), tuple(high)


def _learnt(found: PassiveSet, outcomes: list[Outcome]) -> PassiveSet:
    """Return the set with the margins of trials: negative if a trial fails, nan if it escapes."""
    margin = found.margin.copy()
    for outcome in outcomes:
        value = abs(outcome.margin_ns_per_m)
        margin[place_of(found, outcome.environment)] = (
            value if outcome.passes else -value if np.isfinite(value) else np.nan
        )
    return replace(found, margin=margin)


def _level_map(
    params: MapParams, level: LevelPlan, found: PassiveSet, outcomes: list[Outcome]
) -> LevelMap:
    tried = np.zeros(found.margin.shape, bool)
    for outcome in outcomes:
        tried[place_of(found, outcome.environment)] = True
    passing = [outcome for outcome in outcomes if outcome.passes]
    envelope = envelope_of(passing) if passing else None
    unlike = _unlike(params, level, outcomes)
    return LevelMap(
        level.active_damping_ns_per_m, found, tried.ravel(), tuple(outcomes), envelope, unlike
    )


def _unlike(params: MapParams, level: LevelPlan, outcomes: list[Outcome]) -> int:
    """Return the number of trials that contradict their prediction; points outside the plan are
    predicted here.
    """
    expected = dict(zip(points_of(level.prediction.points), level.prediction.passive, strict=True))
    new = [outcome.environment for outcome in outcomes if outcome.environment not in expected]
    if new:
        guess = _predicted(params, level.active_damping_ns_per_m, np.array(new))
        expected |= dict(zip(new, guess.passive, strict=True))
    return sum(bool(expected[outcome.environment]) != outcome.passes for outcome in outcomes)


def between(found: PassiveSet) -> list[Point]:
    """Return midpoints (K, B, M) [N/m, N s/m, kg] of neighbours with different answers."""
    cube = np.stack(np.meshgrid(*found.axes, indexing="ij"), axis=-1)
    middles: list[Point] = []
    for low, high in map(_neighbours, range(3)):
        unlike = found.passive[low] != found.passive[high]
        middles += points_of(0.5 * (cube[low] + cube[high])[unlike])
    return middles


def halved(found: PassiveSet) -> PassiveSet:
    """Return the set on the finer grid: means between neighbours; nan next to a nan."""
    margin = found.margin
    for place in range(3):
        margin = np.apply_along_axis(_with_means, place, margin)
    k, b, m = (_with_means(axis) for axis in found.axes)
    return PassiveSet((k, b, m), margin)


def place_of(found: PassiveSet, point: Point) -> tuple[int, ...]:
    """Return the indices of a point of the grid."""
    return tuple(
        int(np.searchsorted(axis, value)) for axis, value in zip(found.axes, point, strict=True)
    )


def _with_means(values: Floats) -> Floats:
    finer = np.repeat(values, 2)[:-1]
    finer[1::2] = 0.5 * (values[1:] + values[:-1])
    return np.asarray(finer)
