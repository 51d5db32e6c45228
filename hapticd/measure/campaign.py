"""A map of the passive set: a grid of K, B and M, at any damping levels, as the paper's 13 days of trials, but thriftier.

Everything is predicted first, in about a second. Trials are made where the prediction may be wrong: where it changes when the
environment is scaled by 1 -+ `near` (15 %), and at grid points whose neighbour is predicted otherwise. The rest keeps its
prediction, marked so; `everywhere` makes every trial. `refine` then halves the grid between neighbours of unlike answers.

Outcomes go to an append-only store, keyed by all that they depend on; a map that was interrupted, or is asked again with a
wider grid, makes only the trials that are missing. Tasks run on any executor of concurrent.futures; results do not depend on it.

What would break it: a device whose prediction is off by more than `near` (the limits say by how much it is); then `everywhere`.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Flags, Floats
from hapticd.analysis.boundary import PassiveSet, grid, passive_set
from hapticd.analysis.envelope import Envelope
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.predict import Prediction, predict
from hapticd.measure.outcomes import TOGETHER, Conditions, Outcome, envelope_of, fly, kept, key_of, restored
from hapticd.measure.progress import Progress, silent
from hapticd.measure.scenes import filters
from hapticd.measure.store import TrialStore, fingerprint
from hapticd.plant.compose import compose

Axes = tuple[Floats, Floats, Floats]
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
    """One damping level: the whole grid's prediction, and which points (N,) are to be tried."""

    damping_ns_per_m: float
    prediction: Prediction
    wanted: Flags


@dataclass(frozen=True, eq=False)
class MapPlan:
    """What will be tried."""

    params: MapParams
    levels: tuple[LevelPlan, ...]

    @property
    def trials(self) -> int:
        """Without refinement, and if the store had none."""
        return sum(int(level.wanted.sum()) for level in self.levels)


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
        return predict(model, where, level, chosen, perturbation, params.conditions.band_hz)

    plans = []
    for level in params.levels:
        here = guess(level, points)
        scaled = [guess(level, factor * points).passive for factor in (1.0 - params.near, 1.0 + params.near)]
        wanted = (scaled[0] != here.passive) | (scaled[1] != here.passive) | _at_border(params.axes, here.passive)
        plans.append(LevelPlan(level, here, np.ones_like(wanted) if params.everywhere else wanted))
    return MapPlan(params, tuple(plans))


def run_map(
    plan: MapPlan, store: TrialStore, tell: Progress = silent, executor: Executor | None = None, redraw: Keep = lambda new: None
) -> MapResult:
    """Make the trials that the store has not; `redraw` hears of all outcomes so far after each task.

    KeyboardInterrupt passes through after the tasks in flight were given up; what was finished is in the store.
    """
    conditions, made, levels = plan.params.conditions, 0, []
    shared = fingerprint(conditions)
    for level in plan.levels:
        wanted = [(float(k), float(b), float(m)) for k, b, m in level.prediction.points[level.wanted]]
        new = _make(conditions, shared, level.damping_ns_per_m, wanted, store, tell, executor, redraw)
        for _ in range(plan.params.refine):
            have = _known(conditions, shared, level.damping_ns_per_m, wanted, store)
            between = _between(plan.params.axes, have)
            wanted += [point for point in between if point not in set(wanted)]
            new += _make(conditions, shared, level.damping_ns_per_m, wanted, store, tell, executor, redraw)
        made += new
        levels.append(_level_map(plan.params, level, _known(conditions, shared, level.damping_ns_per_m, wanted, store)))
    return MapResult(plan, tuple(levels), made)


def _make(
    conditions: Conditions, shared: str, level: float, wanted: Sequence[tuple[float, float, float]], store: TrialStore,
    tell: Progress, executor: Executor | None, redraw: Keep,
) -> int:  # fmt: skip
    missing = [point for point in wanted if key_of(conditions, shared, level, point) not in store.known]
    tasks = [np.array(missing[first : first + TOGETHER]) for first in range(0, len(missing), TOGETHER)]
    done, what = len(wanted) - len(missing), f"trials, added damping {level:g} N s/m"
    tell(what, done, len(wanted))
    for outcomes in _flown(conditions, level, tasks, executor):
        store.add((key_of(conditions, shared, level, outcome.environment), kept(outcome)) for outcome in outcomes)
        done += len(outcomes)
        tell(what, done, len(wanted))
        redraw(outcomes)
    return len(missing)


def _flown(conditions: Conditions, level: float, tasks: list[Floats], executor: Executor | None) -> Iterator[list[Outcome]]:
    """Outcomes of tasks as they finish; what has not begun is given up when the caller stops."""
    pool = executor or ThreadPoolExecutor(max_workers=1)  # the engine and `spa` use the cores themselves
    waiting: list[Future[list[Outcome]]] = [pool.submit(fly, conditions, level, task) for task in tasks]
    try:
        for future in as_completed(waiting):
            yield future.result()
    finally:
        for future in waiting:
            future.cancel()
        if executor is None:
            pool.shutdown(wait=True, cancel_futures=True)


def _known(
    conditions: Conditions, shared: str, level: float, wanted: Sequence[tuple[float, float, float]], store: TrialStore
) -> list[Outcome]:
    return [restored(store.known[key_of(conditions, shared, level, point)]) for point in wanted]


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


def _between(axes: Axes, outcomes: list[Outcome]) -> list[tuple[float, float, float]]:
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


def _moved(point: tuple[float, float, float], place: int, value: float) -> tuple[float, float, float]:
    k, b, m = (value if index == place else old for index, old in enumerate(point))
    return k, b, m


def _level_map(params: MapParams, level: LevelPlan, outcomes: list[Outcome]) -> LevelMap:
    margin, tried = level.prediction.decided_margin.copy(), np.zeros(len(level.wanted), bool)
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
