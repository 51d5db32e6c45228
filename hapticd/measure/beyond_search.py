"""The directed search against the grid that it replaces: trials made, and points of the grid that it holds wrongly.

A grid of 2,002 environments is flown twice, all of it, with unlike noise. The first is the truth; how the second differs from
it is what one grid can know of the boundary, the floor. The search has noise of its own. A point is wrong whose yes or no
the search, or the prediction alone, holds otherwise; shares are of the passive points.
"""

from dataclasses import dataclass, replace

import numpy as np

from hapticd.analysis.arrays import Flags
from hapticd.analysis.search import predicted_passive
from hapticd.measure.campaign import Axes, MapParams, plan_map, run_map
from hapticd.measure.directed import SearchParams, SearchResult, observed, plan_search, run_search
from hapticd.measure.outcomes import Conditions
from hapticd.measure.progress import Progress, silent
from hapticd.measure.reproduce_trials import LEVELS
from hapticd.measure.store import TrialStore

SEED, GRID_SEEDS, BUDGETS = 101, (1, 2), (20, 40)
AXES: dict[float, Axes] = {
    LEVELS[0]: (np.linspace(0.0, 450.0, 14), np.linspace(0.0, 4.0, 11), np.linspace(-0.010, 0.016, 13)),
    LEVELS[1]: (np.linspace(0.0, 1400.0, 14), np.linspace(0.0, 10.0, 11), np.linspace(-0.028, 0.040, 13)),
}


@dataclass(frozen=True, eq=False)
class Compared:
    """Of one level of added damping: `points` of the grid, `passive` of them; wrong are `predicted` by prediction alone,
    `other_noise` by the second grid, `searched` by n trials. `found` is the search with all of its trials."""

    damping_ns_per_m: float
    points: int
    passive: int
    predicted: int
    other_noise: int
    searched: dict[int, int]
    found: SearchResult

    @property
    def enough(self) -> int | None:
        """The first number of trials that leaves no more wrong than the floor; None if none did."""
        return next((count for count, wrong in self.searched.items() if wrong <= self.other_noise), None)

    def share(self, wrong: int) -> float:
        """Of the passive points [%]."""
        return 100.0 * wrong / self.passive


def compared_with_grid(
    conditions: Conditions, damping_ns_per_m: float, budgets: tuple[int, ...] = BUDGETS, tell: Progress = silent
) -> Compared:
    """Fly the grid twice, search once with `budgets[-1]` trials; the search after fewer trials is a part of that one."""
    truth, again = (_grid(conditions, damping_ns_per_m, seed, tell) for seed in GRID_SEEDS)
    plan = plan_map(MapParams(conditions, AXES[damping_ns_per_m], (damping_ns_per_m,)))
    prediction = plan.levels[0].prediction
    own = replace(conditions, excitation=replace(conditions.excitation, seed=SEED))
    search = plan_search(SearchParams(own, damping_ns_per_m, budgets[-1], doubt=0.0))
    found = run_search(search, TrialStore(None), tell)
    searched = {}
    for count in budgets:  # what is tried does not depend on how many trials are to follow
        outcomes = [step.outcome for step in found.steps[:count]]
        known = search.begin.with_trials([one.environment for one in outcomes], [observed(own, one) for one in outcomes])
        searched[count] = int((predicted_passive(known, prediction.points) != truth).sum())
    predicted, floor = (int((other != truth).sum()) for other in (prediction.passive, again))
    return Compared(damping_ns_per_m, truth.size, int(truth.sum()), predicted, floor, searched, found)


def _grid(conditions: Conditions, damping_ns_per_m: float, seed: int, tell: Progress) -> Flags:
    other = replace(conditions, excitation=replace(conditions.excitation, seed=seed))
    plan = plan_map(MapParams(other, AXES[damping_ns_per_m], (damping_ns_per_m,), everywhere=True))
    return run_map(plan, TrialStore(None), tell).levels[0].found.passive.ravel()
