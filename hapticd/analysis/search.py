"""The directed search that the paper left to future work: few trials, each where it tells most about the boundary.

A `surrogate` of Re Z(w; K, B, M) says where the boundary probably is, and how well it knows. Rays from the middle of the set
meet it in `N_RAYS` points; the next trial is the one whose Re Z is least certain, which without noise is the one farthest from
all trials so far. So every trial also confirms the boundary that was predicted. On an affine device 4 trials suffice; with a
smooth non-affine part about 45 leave 2 % of the volume wrong, where a grid of yes and no needs 180,000.

Stability is a question of its own (K < 0, slow poles): `stable`, if given, narrows the set; unstable trials are not learnt from.

What would break it: a first trial that is not passive, or a set that rays from its middle meet twice.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hapticd.analysis.arrays import Flags, Floats
from hapticd.analysis.surrogate import Box, Observation, Surrogate, fit, margin, margin_sd, resistance
from hapticd.errors import AnalysisError

Predicate = Callable[[Floats], Flags]
Oracle = Callable[[Floats], Observation | None]

N_RAYS = 400
N_INSIDE = 3000  # random environments that find the middle and the volume
FIRST_STEPS = (0.15, 0.12, 0.10)  # of the box, of K, B and M
_HALVINGS = 12
_EDGE = 0.999  # of the way to the end of the box
_EDGE_INTEREST = 0.3  # of a point at the end of the box, where the set goes on


@dataclass(frozen=True, eq=False)
class Search:
    """State of a search: the box, stable trials, environments that were not stable, and the fit (None before four trials)."""

    box: Box
    trials: tuple[Observation, ...] = ()
    unstable: tuple[Floats, ...] = ()
    surrogate: Surrogate | None = None

    def with_trial(self, environment: Floats, seen: Observation | None) -> "Search":
        """The search after a trial; None where the loop was not stable."""
        if seen is None:
            return Search(self.box, self.trials, (*self.unstable, np.asarray(environment)), self.surrogate)
        trials = (*self.trials, seen)
        return Search(self.box, trials, self.unstable, fit(self.box, trials) if len(trials) >= 4 else None)


def first_trials(box: Box, inside: npt.ArrayLike) -> Floats:
    """(4, 3): `inside`, an environment that is passive for sure, and a step from it along each axis, towards the farther end."""
    centre = box.to_unit(inside)[0]
    if np.any(centre < 0.0) or np.any(centre > 1.0):
        raise AnalysisError(f"the first environment {np.asarray(inside).tolist()} lies outside the box {box.low}..{box.high}")
    steps = np.diag(np.where(centre <= 0.5, 1.0, -1.0) * np.asarray(FIRST_STEPS))
    return box.to_environment(np.vstack((centre, centre + steps)))


def next_trials(search: Search, count: int = 1, stable: Predicate | None = None) -> Floats:
    """Environments (count, 3) to try next, in order; more than one are chosen as if the ones before had been as expected."""
    chosen: list[Floats] = []
    trials, found = search.trials, _fitted(search)
    for _ in range(count):
        chosen.append(_most_telling(found, _predicate(found, search, stable)))
        expected = Observation(chosen[-1], resistance(found, chosen[-1])[0], trials[-1].sd)
        trials = (*trials, expected)
        found = fit(search.box, trials) if len(chosen) < count else found
    return np.stack(chosen)


def predicted_passive(search: Search, environments: npt.ArrayLike, stable: Predicate | None = None) -> Flags:
    """(N,) whether the search holds each of `environments` (N, 3) for passive."""
    return _predicate(_fitted(search), search, stable)(np.atleast_2d(np.asarray(environments, np.float64)))


def boundary_points(search: Search, stable: Predicate | None = None) -> tuple[Floats, Flags]:
    """Environments (N_RAYS, 3) where rays from the middle leave the set, and which of them are ends of the box."""
    found = _fitted(search)
    unit, ends = _boundary(search.box, _predicate(found, search, stable), _middle(found, _predicate(found, search, stable)))
    return search.box.to_environment(unit), ends


def doubtful_share(search: Search) -> float:
    """Volume whose margin is within one standard deviation of 0, over the volume held for passive: when to stop."""
    found = _fitted(search)
    inside = search.box.to_environment(_samples())
    expected = margin(found, inside)
    passive = int((expected >= 0.0).sum())
    near = np.abs(expected) < np.quantile(np.abs(expected), 0.5)
    doubtful = int((margin_sd(found, inside[near]) > np.abs(expected[near])).sum())
    return doubtful / max(1, passive)


def directed_search(
    oracle: Oracle, box: Box, inside: npt.ArrayLike, budget: int, stable: Predicate | None = None, doubt: float = 0.0
) -> Search:
    """Ask `oracle` at most `budget` times, or until `doubtful_share` is below `doubt`. The oracle gets (K, B, M) (3,) and returns
    what it saw, None if the loop was not stable. AnalysisError if one of the first four trials was not."""
    search = Search(box)
    for environment in first_trials(box, inside):
        search = search.with_trial(environment, oracle(environment))
    if search.unstable:
        raise AnalysisError(f"not stable at {search.unstable[0].tolist()}: begin nearer to K = B = M = 0, or take a smaller box")
    while len(search.trials) + len(search.unstable) < budget and doubtful_share(search) >= doubt:
        environment = next_trials(search, 1, stable)[0]
        search = search.with_trial(environment, oracle(environment))
    return search


def _fitted(search: Search) -> Surrogate:
    if search.surrogate is None:
        raise AnalysisError(f"{len(search.trials)} stable trials so far: four are needed before the search can direct")
    return search.surrogate


def _predicate(found: Surrogate, search: Search, stable: Predicate | None) -> Predicate:
    """Passive by the surrogate, stable by `stable`, and not nearer to an unstable trial than to every stable one."""
    bad = search.box.to_unit(search.unstable) if search.unstable else np.empty((0, 3))

    def holds(environments: Floats) -> Flags:
        passive = margin(found, environments) >= 0.0
        if len(bad):
            unit = search.box.to_unit(environments)
            passive &= _distance(unit, bad) > _distance(unit, found.unit)
        if stable is not None and passive.any():
            passive[passive] = stable(environments[passive])
        return passive

    return holds


def _most_telling(found: Surrogate, holds: Predicate) -> Floats:
    unit, ends = _boundary(found.box, holds, _middle(found, holds))
    environments = found.box.to_environment(unit)
    far = _distance(unit, found.unit)
    told = (margin_sd(found, environments) / max(found.amplitude, 1e-300) + 1e-6 * far) * np.where(ends, _EDGE_INTEREST, 1.0)
    return np.asarray(environments[np.argmax(told)])


def _middle(found: Surrogate, holds: Predicate) -> Floats:
    """Mean of the set, or the trial with the largest margin where that is not inside. (3,) in the unit box."""
    samples = _samples()
    inside = samples[holds(found.box.to_environment(samples))]
    mean = inside.mean(axis=0) if len(inside) else found.unit[0]
    if holds(found.box.to_environment(mean))[0]:
        return np.asarray(mean)
    return np.asarray(found.unit[np.argmax(margin(found, found.box.to_environment(found.unit)))])


def _boundary(box: Box, holds: Predicate, middle: Floats) -> tuple[Floats, Flags]:
    """Where rays from `middle` leave the set: (N_RAYS, 3) in the unit box, and which reach the box's end inside it."""
    rays = _rays()
    with np.errstate(divide="ignore"):
        to_end = np.where(rays > 0.0, (1.0 - middle) / rays, np.where(rays < 0.0, -middle / rays, np.inf)).min(axis=1)
    low, high = np.zeros(N_RAYS), _EDGE * to_end
    ends = holds(box.to_environment(middle + rays * high[:, None]))
    low = np.where(ends, high, low)
    for _ in range(_HALVINGS):
        half = 0.5 * (low + high)
        inside = holds(box.to_environment(middle + rays * half[:, None]))
        low, high = np.where(inside, half, low), np.where(inside, high, half)
    return middle + rays * (0.5 * (low + high))[:, None], ends


def _rays() -> Floats:
    """Directions (N_RAYS, 3) evenly over the sphere: a Fibonacci spiral."""
    at = np.arange(N_RAYS) + 0.5
    down, around = np.arccos(1.0 - 2.0 * at / N_RAYS), np.pi * (1.0 + np.sqrt(5.0)) * at
    return np.column_stack((np.cos(around) * np.sin(down), np.sin(around) * np.sin(down), np.cos(down)))


def _samples() -> Floats:
    return np.random.default_rng(1).random((N_INSIDE, 3))


def _distance(one: Floats, other: Floats) -> Floats:
    return np.asarray(np.sqrt(((one[:, None] - other) ** 2).sum(axis=2)).min(axis=1))
