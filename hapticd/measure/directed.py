"""The directed search with trials of the engine: few trials, each where it tells most about the boundary of the passive set.

`analysis.search` learns from the trials and chooses; here its oracle is a simulated trial with its intervals as weights. What is
known beforehand is the device's model (`analysis.foresight`): the trials teach how Re Z differs from the prediction, and how
near to its friction's end the loop may come in a trial before it escapes. Trials are made a few at a time (`directed_trials`).

The set that is found is the paper's: environments whose trial rather passes than fails. A trial that escapes, or whose command
saturates, teaches no spectrum, only that the loop is not stable there.

Each trial is also a check: what was expected of it before it was learnt is kept beside what it gave (`Step`).
"""

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.boundary import PassiveSet, grid, passive_set
from hapticd.analysis.foresight import Foresight
from hapticd.analysis.search import Search, doubtful_share, first_trials, next_trials, predicted_passive
from hapticd.analysis.spa import DEFAULT_LAG
from hapticd.analysis.surrogate import Box, margin
from hapticd.errors import AnalysisError
from hapticd.measure.axis_scan import LimitsParams, plan_limits
from hapticd.measure.directed_trials import learnt_at, make, observed, rounded
from hapticd.measure.executors import pool_of
from hapticd.measure.outcomes import Conditions, Hear, Outcome
from hapticd.measure.progress import Progress, silent
from hapticd.measure.scenes import filters, perturbation
from hapticd.measure.store import TrialStore
from hapticd.plant.compose import compose
from hapticd.units import PROBE_RATE_HZ

ROOM = (3.2, 1.3, 1.3)  # the box beyond the predicted axis limits of K, B, -M
HEAVIER = 1.6  # its positive end of M over the negative one
SET_GRID = (24, 20, 24)
INDEPENDENT_HZ = PROBE_RATE_HZ / (0.75 * DEFAULT_LAG)  # values of an estimate that are so far apart are independent


@dataclass(frozen=True, slots=True)
class SearchParams:
    """`budget` trials at most, `together` at a time; ends below `doubt`. `box` None: from the predicted axis limits."""

    conditions: Conditions
    damping_ns_per_m: float
    budget: int = 40
    together: int = 4
    doubt: float = 0.02
    box: Box | None = None


@dataclass(frozen=True, eq=False)
class SearchPlan:
    """The box, and the search before its first trial, with what is known beforehand."""

    params: SearchParams
    box: Box
    begin: Search


@dataclass(frozen=True, eq=False)
class Step:
    """One trial with the margin [N s/m] that was expected of it; `teaches` no spectrum where the loop was not stable."""

    outcome: Outcome
    expected_ns_per_m: float
    teaches: bool


@dataclass(frozen=True, eq=False)
class SearchResult:
    """`found`: the set as the search holds it, on a grid of the box; `doubt`: share of the volume that noise leaves open."""

    plan: SearchPlan
    search: Search
    steps: tuple[Step, ...]
    found: PassiveSet
    doubt: float


def plan_search(params: SearchParams) -> SearchPlan:
    """Box and foresight from the prediction. AnalysisError where nothing is predicted to be passive."""
    box, f = params.box or _box(params), learnt_at(params.conditions)
    scene, source = params.conditions.scene, perturbation(params.conditions.excitation)
    known = Foresight(compose(scene), box, f, params.damping_ns_per_m, filters(scene), source)
    begin = Search(box, known.resistance, known.headroom, np.gradient(f) / INDEPENDENT_HZ)
    return SearchPlan(params, box, begin)


def run_search(
    plan: SearchPlan, store: TrialStore, tell: Progress = silent, executor: Executor | None = None, hear: Hear = lambda new: None
) -> SearchResult:
    """Search, trials on `executor` or on threads here; `hear` gets the outcomes of each round.

    AnalysisError if one of the first four trials, near K = B = M = 0, is not stable.
    """
    params, search, steps = plan.params, plan.begin, list[Step]()
    wanted = rounded(first_trials(plan.box, np.zeros(3)))
    with pool_of(executor) as pool:
        while True:
            tell("trials", len(steps), params.budget)
            expected = _expected(search, wanted)
            outcomes = make(params.conditions, params.damping_ns_per_m, wanted, len(steps), store, pool, hear)
            seen = [observed(params.conditions, outcome) for outcome in outcomes]
            for outcome, guess, one in zip(outcomes, expected, seen, strict=True):
                steps.append(Step(outcome, float(guess), one is not None))
            search = search.with_trials(wanted, seen)
            if search.surrogate is None:
                raise AnalysisError("a trial next to K = B = M = 0 was not stable: this display is not passive by itself")
            count = min(params.together, params.budget - len(steps))
            if count <= 0 or doubtful_share(search) < params.doubt:
                break
            wanted = rounded(next_trials(search, count))
    tell("trials", len(steps), params.budget)
    return SearchResult(plan, search, tuple(steps), _set(search), doubtful_share(search))


def _box(params: SearchParams) -> Box:
    limits = plan_limits(LimitsParams(params.conditions, (params.damping_ns_per_m,))).scans
    k, b, m = (room * scan.predicted for room, scan in zip(ROOM, limits, strict=True))
    if not np.isfinite((k, b, m)).all() or not (k > 0.0 and b > 0.0 and m < 0.0):
        raise AnalysisError("nothing is predicted to be passive from K = B = M = 0 on, so there is no boundary to search")
    return Box((0.0, 0.0, m), (k, b, -HEAVIER * m))


def _expected(search: Search, wanted: Floats) -> Floats:
    if search.surrogate is not None:
        return margin(search.surrogate, wanted)
    assert search.prior is not None
    return np.asarray(search.prior(wanted).min(axis=1))


def _set(search: Search) -> PassiveSet:
    """Expected margins; where the search holds a point for not passive, their size with a minus."""
    assert search.surrogate is not None
    box = search.box
    k, b, m = (np.linspace(box.low[place], box.high[place], count) for place, count in enumerate(SET_GRID))
    points = grid((k, b, m))
    size = np.abs(margin(search.surrogate, points))
    return passive_set((k, b, m), np.where(predicted_passive(search, points), size, -np.maximum(size, 1e-12)))
