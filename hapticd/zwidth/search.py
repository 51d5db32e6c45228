"""Search for the boundary of the passive set with few simulated trials, each where it gives most
information.

`acquisition` learns from the trials and chooses the next; here its oracle is a simulated trial,
with its intervals as weights. The prior is the device's model (`ModelPrior`). The trials teach how
Re Z differs from the prediction, and how close to the limit of its friction the loop may come
before it escapes. A few trials run at a time, each with noise of its own (seed, seed + 1, ..), as
in a laboratory: with one noise for all, random error would be learnt as a property of the device.
The same search makes the same trials, and continues after an interruption.

If a set extends beyond the box, the search finds the box. The box reaches beyond the predicted
limits along the axes. It is widened until no face of it is predicted to be passive: with some B a
device allows more K and M than the axes show. `open_ends` lists the ends where the set that was
found still continues. The faces K = 0 and B = 0 do not move: the search begins there.

The result is the paper's set: environments whose trial probably passes. A trial that escapes, or
whose command saturates, gives no spectrum, only the fact that the loop is not stable there. Each
trial is also a check: `Step` stores the expectation before it was learnt with its result. A `Slice`
through the result is the largest passive K over B at one M, with the prediction before the first
trial.

Limitations: a device whose Re Z differs from the prediction in a way that changes faster than the
surrogate's correlation lengths (`zwidth.surrogate`); no later trial then corrects it.
"""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np

from hapticd.core.arrays import Flags, Floats, bisect
from hapticd.core.errors import AnalysisError
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.signal.spectra import DEFAULT_LAG
from hapticd.signal.verdict import Judged
from hapticd.zwidth.acquisition import (
    ModelPrior,
    Search,
    doubtful_share,
    first_trials,
    next_trials,
    predicted_passive,
)
from hapticd.zwidth.limits import predicted_limit
from hapticd.zwidth.outcomes import (
    Conditions,
    OnOutcomes,
    Outcome,
    Procedure,
    TrialBatch,
    judged,
    kept_frequencies,
    points_of,
    run_all,
)
from hapticd.zwidth.passive_set import PassiveSet, grid
from hapticd.zwidth.sources import SATURATED
from hapticd.zwidth.store import Progress, TrialStore, silent
from hapticd.zwidth.surrogate import Box, Observation, margin

__all__ = ["SearchParams", "SearchResult", "observed", "plan_search", "run_search"]

ROOM = (3.2, 1.3, 1.3)  # factors: the box beyond the predicted axis limits of K, B, -M
HEAVIER = 1.6  # its positive end of M over the negative one, before it is widened
WIDER = 1.5  # factor by which an open end is moved
WIDENINGS = 8  # at most: 25 times as far
FACE = 24  # values along each side of a face
SET_GRID = (24, 20, 24)
INDEPENDENT_HZ = PROBE_RATE_HZ / (
    0.75 * DEFAULT_LAG
)  # spacing at which values of an estimate are independent
POOR = 0.2  # median relative standard deviation over the band above which a spectrum is not used
UNKNOWN = 10.0  # relative standard deviation of a value that is not used
DIGITS = 6  # of an environment, as requested and stored
SLICE = (30, 80)  # of K and B
_HALVINGS = 7


@dataclass(frozen=True, slots=True)
class SearchParams:
    """`budget` trials at most, `together` at a time; ends below `doubt`. `box` None: one that
    contains the predicted set.
    """

    conditions: Conditions
    active_damping_ns_per_m: float
    budget: int = 40
    together: int = 4
    doubt: float = 0.02
    box: Box | None = None


@dataclass(frozen=True, eq=False)
class SearchPlan:
    """The box, and the search before its first trial, with its prior."""

    params: SearchParams
    box: Box
    begin: Search


@dataclass(frozen=True, eq=False)
class Step:
    """One trial with the margin [N s/m] that was expected; `teaches` is False if the loop was not
    stable and gave no spectrum.
    """

    outcome: Outcome
    expected_ns_per_m: float
    teaches: bool


@dataclass(frozen=True, eq=False)
class SearchResult:
    """`found`: the set of the search, on a grid of the box; `doubt`: share of the volume still
    undecided because of noise.
    """

    plan: SearchPlan
    search: Search
    steps: tuple[Step, ...]
    found: PassiveSet
    doubt: float

    @property
    def judged(self) -> Judged:
        """The range of frequencies judged in every trial."""
        return judged(step.outcome for step in self.steps)

    @property
    def open_ends(self) -> tuple[str, ...]:
        """Ends of the box at which the set continues, such as "M max"."""
        return self.found.open_ends()


def plan_search(params: SearchParams) -> SearchPlan:
    """Return the box and the prior from the prediction. AnalysisError if no environment is
    predicted to be passive.
    """
    box = params.box or _closed(params, _box(params))
    f = learnt_at(params.conditions)
    device = params.conditions.display
    known = ModelPrior(
        device.model, box, f, params.active_damping_ns_per_m, device.filters, device.perturbation
    )
    begin = Search(box, known.resistance, known.headroom, np.gradient(f) / INDEPENDENT_HZ)
    return SearchPlan(params, box, begin)


def run_search(
    plan: SearchPlan,
    store: TrialStore,
    tell: Progress = silent,
    executor: Executor | None = None,
    on_outcomes: OnOutcomes = lambda new: None,
) -> SearchResult:
    """Search, with trials on `executor` or on threads of this process; `on_outcomes` receives the
    outcomes of each round.

    AnalysisError if one of the first four trials, near K = B = M = 0, is not stable.
    """
    return run_all([_searched(plan, store, tell, on_outcomes)], store, executor)[0]


def _searched(
    plan: SearchPlan, store: TrialStore, tell: Progress, on_outcomes: OnOutcomes
) -> Procedure[SearchResult]:
    """`on_outcomes` receives the new outcomes of a round, in the order of the search."""
    params = plan.params
    search = plan.begin
    steps = list[Step]()
    wanted = rounded(first_trials(plan.box, np.zeros(3)))
    while True:
        tell("trials", len(steps), params.budget)
        expected = _expected(search, wanted)
        batches = _batches(params, wanted, len(steps))
        new = {
            point
            for batch in batches
            for point, key in batch.keys.items()
            if key not in store.known
        }
        outcomes = yield batches
        if new:
            on_outcomes([outcome for outcome in outcomes if outcome.environment in new])
        seen = [observed(params.conditions, outcome) for outcome in outcomes]
        for outcome, guess, one in zip(outcomes, expected, seen, strict=True):
            steps.append(Step(outcome, float(guess), one is not None))
        search = search.with_trials(wanted, seen)
        if search.surrogate is None:
            raise AnalysisError(
                "a trial next to K = B = M = 0 was not stable: this display is not passive by"
                " itself"
            )
        count = min(params.together, params.budget - len(steps))
        if count <= 0 or doubtful_share(search) < params.doubt:
            break
        wanted = rounded(next_trials(search, count))
    tell("trials", len(steps), params.budget)
    return SearchResult(plan, search, tuple(steps), _set(search), doubtful_share(search))


def _batches(params: SearchParams, wanted: Floats, done: int) -> list[TrialBatch]:
    """Return a trial for each of `wanted` (n, 3) after `done` trials, with noise of its own."""
    return [
        TrialBatch(
            params.conditions.perturbed(more_seed=place), params.active_damping_ns_per_m, (point,)
        )
        for place, point in enumerate(points_of(wanted), done)
    ]


def rounded(wanted: Floats) -> Floats:
    """Round environments (n, 3) to the stored digits."""
    return np.array([[float(f"{value:.{DIGITS}g}") for value in point] for point in wanted])


def _box(params: SearchParams) -> Box:
    given = params.conditions
    limits = [
        predicted_limit(given.display, params.active_damping_ns_per_m, axis, band_hz=given.band_hz)
        for axis in range(3)
    ]
    k, b, m = (room * limit for room, limit in zip(ROOM, limits, strict=True))
    if not np.isfinite((k, b, m)).all() or not (k > 0.0 and b > 0.0 and m < 0.0):
        raise AnalysisError(
            "nothing is predicted to be passive from K = B = M = 0 on, so there is no boundary to"
            " search"
        )
    return Box((0.0, 0.0, m), (k, b, -HEAVIER * m))


def _closed(params: SearchParams, box: Box) -> Box:
    """Return `box`, widened until the predicted set ends in it, except at K = 0 and B = 0."""
    for _ in range(WIDENINGS):
        low, high = (
            tuple(
                WIDER * end if end and _passive_face(params, box, axis, end) else end
                for axis, end in enumerate(ends)
            )
            for ends in (box.low, box.high)
        )
        wider = Box((low[0], low[1], low[2]), (high[0], high[1], high[2]))
        if wider == box:
            break
        box = wider
    return box


def _passive_face(params: SearchParams, box: Box, axis: int, end: float) -> bool:
    """Whether the face of `box` at `end` of `axis` is predicted to be passive anywhere."""
    sides = [np.linspace(low, high, FACE) for low, high in zip(box.low, box.high, strict=True)]
    sides[axis] = np.array([end])
    points = grid((sides[0], sides[1], sides[2]))
    given = params.conditions
    return bool(given.display.passive(points, params.active_damping_ns_per_m, given.band_hz).any())


def _expected(search: Search, wanted: Floats) -> Floats:
    if search.surrogate is not None:
        return margin(search.surrogate, wanted)
    assert search.prior is not None
    return np.asarray(search.prior(wanted).min(axis=1))


def _set(search: Search) -> PassiveSet:
    """Return expected margins; negative where the search predicts a point to be not passive."""
    assert search.surrogate is not None
    box = search.box
    k, b, m = (
        np.linspace(box.low[place], box.high[place], count) for place, count in enumerate(SET_GRID)
    )
    points = grid((k, b, m))
    size = np.abs(margin(search.surrogate, points))
    return PassiveSet.of(
        (k, b, m), np.where(predicted_passive(search, points), size, -np.maximum(size, 1e-12))
    )


def learnt_at(conditions: Conditions) -> Floats:
    """Return the frequencies (F,) of the learnt spectra."""
    f = kept_frequencies(conditions.band_hz)
    return f[(f >= conditions.band_hz[0]) & (f <= conditions.band_hz[1])]


def observed(conditions: Conditions, outcome: Outcome) -> Observation | None:
    """Return the spectrum learnt from a trial; None if the loop was not stable, or its motion had
    another cause than the perturbation.
    """
    escaped = outcome.max_force_n >= SATURATED * conditions.display.force_limit_n or (
        not outcome.passes and outcome.margin_ns_per_m > 0.0
    )
    if not outcome.z.size or escaped:
        return None
    inside = np.isin(outcome.frequency_hz, learnt_at(conditions))
    relative = outcome.relative_sd[inside]
    if not np.median(relative) < POOR:
        return None
    size = np.hypot(*outcome.z[inside].T)
    sd = np.where(np.isfinite(size), size, np.nanmax(size)) * np.minimum(relative, UNKNOWN)
    return Observation(np.asarray(outcome.environment), np.nan_to_num(outcome.z[inside, 0]), sd)


@dataclass(frozen=True, eq=False)
class Slice:
    """Largest K (nB,) at each `damping` (nB,) of a plane of one M, as `held` by the search and as
    `predicted` before any trial.
    """

    mass_kg: float
    virtual_damping: Floats
    held: Floats
    predicted: Floats


def slice_at(result: SearchResult, mass_kg: float) -> Slice:
    """Return the plane of one M through the box: the result of the search, and the prediction
    before any trial.
    """
    params = result.plan.params
    box = result.plan.box
    given = params.conditions
    level = params.active_damping_ns_per_m
    damping = np.linspace(box.low[1], box.high[1], SLICE[1])

    held = partial(predicted_passive, result.search)
    guessed = partial(given.display.passive, level=level, band_hz=given.band_hz)
    edges = (_highest(holds, box, damping, mass_kg) for holds in (held, guessed))
    return Slice(mass_kg, damping, *edges)


def _highest(holds: Callable[[Floats], Flags], box: Box, damping: Floats, mass_kg: float) -> Floats:
    """Return the largest K (nB,) that holds at each damping, nan if none does: on a grid, then
    bisected to 1 % of its step.
    """
    k = np.linspace(box.low[0], box.high[0], SLICE[0])
    held = holds(np.array([(stiffness, b, mass_kg) for stiffness in k for b in damping])).reshape(
        k.size, damping.size
    )
    top = k.size - 1 - np.argmax(held[::-1], axis=0)
    edge, _ = bisect(
        lambda half: holds(np.column_stack((half, damping, np.full_like(half, mass_kg)))),
        k[top],
        k[np.minimum(top + 1, k.size - 1)],
        _HALVINGS,
    )
    return np.where(held.any(axis=0), edge, np.nan)
