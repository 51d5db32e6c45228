"""The directed search with trials of the engine: few trials, each where it tells most about the boundary of the passive set.

`analysis.search` learns Re Z(w; K, B, M) from the trials and chooses; here its oracle is a simulated trial with its intervals
as weights. Trials are made a few at a time, chosen as if those before had come out as expected. A trial that escapes, or whose
command saturates, teaches no spectrum, only that the loop is not stable there; where it is to be expected, the prediction
says, on a grid made once.

Each trial is also a check: what was expected of it before it was learnt is kept beside what it gave (`Step`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Flags, Floats
from hapticd.analysis.boundary import PassiveSet, grid, passive_set
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.predict import predict
from hapticd.analysis.search import Search, boundary_points, doubtful_share, first_trials, next_trials
from hapticd.analysis.surrogate import Box, Observation, margin
from hapticd.errors import AnalysisError
from hapticd.measure.axis_scan import LimitsParams, plan_limits
from hapticd.measure.outcomes import Conditions, Outcome, fly, kept, kept_frequencies, key_of, restored
from hapticd.measure.progress import Progress, silent
from hapticd.measure.scenes import filters
from hapticd.measure.store import TrialStore, fingerprint
from hapticd.plant.compose import compose

ROOM = (3.2, 1.3, 1.3)  # the box beyond the predicted axis limits of K, B, -M
HEAVIER = 1.6  # its positive end of M over the negative one
STABLE_GRID = (20, 12, 14)
SET_GRID = (24, 20, 24)
APART = 0.05  # of the unit box: nearer to a trial there is nothing to learn that noise would not hide
POOR = 0.2  # relative standard deviation, the median over the band, of a spectrum that teaches nothing
DIGITS = 6  # of an environment: what is asked is what is stored


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
    """The box, and where the loop is predicted to be stable: `stable` takes (N, 3)."""

    params: SearchParams
    box: Box
    stable: Callable[[Floats], Flags]


@dataclass(frozen=True, eq=False)
class Step:
    """One trial with the margin [N s/m] that was expected of it; nan for the first four."""

    outcome: Outcome
    expected_ns_per_m: float


@dataclass(frozen=True, eq=False)
class SearchResult:
    """`found`: the set as the search holds it, on a grid of the box; `doubt`: share of the volume that noise leaves open."""

    plan: SearchPlan
    search: Search
    steps: tuple[Step, ...]
    found: PassiveSet
    doubt: float


def plan_search(params: SearchParams) -> SearchPlan:
    """Box and stability from the prediction. AnalysisError where nothing is predicted to be passive."""
    box = params.box or _box(params)
    source, scene = params.conditions.excitation, params.conditions.scene
    axes = [np.linspace(box.low[place], box.high[place], count) for place, count in enumerate(STABLE_GRID)]
    found = predict(
        compose(scene), grid((axes[0], axes[1], axes[2])), params.damping_ns_per_m, filters(scene),
        Perturbation(source.psd_n2_per_hz, source.band_hz), params.conditions.band_hz,
    )  # fmt: skip
    calm = (found.calm & ~(found.spectral_radius >= 1.0)).reshape(STABLE_GRID)

    def stable(environments: Floats) -> Flags:
        unit = np.clip(box.to_unit(environments), 0.0, 1.0)
        place = np.rint(unit * (np.array(STABLE_GRID) - 1)).astype(int)
        return np.asarray(calm[place[:, 0], place[:, 1], place[:, 2]], np.bool_)

    return SearchPlan(params, box, stable)


def run_search(plan: SearchPlan, store: TrialStore, tell: Progress = silent) -> SearchResult:
    """Search. AnalysisError if one of the first four trials, near K = B = M = 0, is not stable."""
    params, search, steps = plan.params, Search(plan.box), list[Step]()
    wanted = first_trials(plan.box, np.zeros(3))
    while True:
        tell("trials", len(steps), params.budget)
        expected = np.full(len(wanted), np.nan) if search.surrogate is None else margin(search.surrogate, wanted)
        for outcome, guess in zip(_tried(params, wanted, store), expected, strict=True):
            steps.append(Step(outcome, float(guess)))
            search = search.with_trial(np.asarray(outcome.environment), _observed(params.conditions, outcome))
        if search.surrogate is None:
            raise AnalysisError("a trial next to K = B = M = 0 was not stable: this display is not passive by itself")
        count = min(params.together, params.budget - len(steps))
        if count <= 0 or doubtful_share(search) < params.doubt:
            break
        wanted = _next(plan, search, count)
    tell("trials", len(steps), params.budget)
    return SearchResult(plan, search, tuple(steps), _set(plan, search), doubtful_share(search))


def _box(params: SearchParams) -> Box:
    limits = plan_limits(LimitsParams(params.conditions, (params.damping_ns_per_m,))).scans
    k, b, m = (room * scan.predicted for room, scan in zip(ROOM, limits, strict=True))
    if not np.isfinite((k, b, m)).all() or not (k > 0.0 and b > 0.0 and m < 0.0):
        raise AnalysisError("nothing is predicted to be passive from K = B = M = 0 on: name a box with --box")
    return Box((0.0, 0.0, m), (k, b, -HEAVIER * m))


def _tried(params: SearchParams, wanted: Floats, store: TrialStore) -> list[Outcome]:
    shared, level = fingerprint(params.conditions), params.damping_ns_per_m
    points = [(float(f"{k:.{DIGITS}g}"), float(f"{b:.{DIGITS}g}"), float(f"{m:.{DIGITS}g}")) for k, b, m in wanted]
    keys = [key_of(params.conditions, shared, level, point) for point in points]
    missing = [place for place, key in enumerate(keys) if key not in store.known]
    if missing:
        found = fly(params.conditions, level, np.array([points[place] for place in missing]))
        store.add((keys[place], kept(outcome)) for place, outcome in zip(missing, found, strict=True))
    return [restored(store.known[key]) for key in keys]


def _next(plan: SearchPlan, search: Search, count: int) -> Floats:
    """Trials that tell most; in place of those that repeat a trial, the points of the boundary farthest from all of them."""
    tried = [*plan.box.to_unit([trial.environment for trial in search.trials])]
    tried += [*plan.box.to_unit(search.unstable)] if search.unstable else []
    candidates = [*plan.box.to_unit(next_trials(search, count, plan.stable))]
    edge, _ = boundary_points(search, plan.stable)
    others = [*plan.box.to_unit(edge)]
    chosen: list[Floats] = []
    while len(chosen) < count:
        point = candidates.pop(0) if candidates else max(others, key=lambda other: _nearest(other, tried))
        if _nearest(point, tried) < min(APART, max(_nearest(other, tried) for other in others)):
            continue
        chosen.append(point)
        tried.append(point)
    return plan.box.to_environment(np.array(chosen))


def _nearest(point: Floats, others: list[Floats]) -> float:
    return float(np.linalg.norm(np.asarray(others) - point, axis=1).min())


def _observed(conditions: Conditions, outcome: Outcome) -> Observation | None:
    """What a trial teaches; None where the loop was not stable, or moved by something else than the perturbation."""
    limit_n = compose(conditions.scene).force_limit_n or np.inf
    if (
        not outcome.z.size
        or outcome.max_force_n >= limit_n * (1.0 - 1e-6)
        or (not outcome.passes and outcome.margin_ns_per_m > 0.0)
    ):
        return None
    f = kept_frequencies()
    inside = (f >= conditions.band_hz[0]) & (f <= conditions.band_hz[1])
    relative = outcome.relative_sd[inside]
    if not np.median(relative) < POOR:
        return None
    sd = np.hypot(*outcome.z[inside].T) * np.minimum(relative, 10.0)
    return Observation(np.asarray(outcome.environment), outcome.z[inside, 0], sd)


def _set(plan: SearchPlan, search: Search) -> PassiveSet:
    assert search.surrogate is not None
    box = plan.box
    axes = tuple(np.linspace(box.low[place], box.high[place], count) for place, count in enumerate(SET_GRID))
    points = grid((axes[0], axes[1], axes[2]))
    found = margin(search.surrogate, points)
    found[(found >= 0.0) & ~plan.stable(points)] = np.nan
    return passive_set((axes[0], axes[1], axes[2]), found)
