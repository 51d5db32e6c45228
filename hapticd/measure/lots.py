"""A lot: trials under one set of conditions, from the store or flown and stored.

A trial's key is all that it depends on, so what a store has is never flown again, whoever asked for it. Each task is stored as
soon as it is finished; what has not begun is given up when the caller stops.
"""

from collections.abc import Iterable, Iterator
from concurrent.futures import Executor, Future, as_completed
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.measure.outcomes import TOGETHER, Conditions, Hear, Outcome, fly, kept, key_of, restored
from hapticd.measure.progress import Progress
from hapticd.measure.store import TrialStore, fingerprint

Point = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Lot:
    """Trials under one set of conditions."""

    conditions: Conditions
    damping_ns_per_m: float
    points: tuple[Point, ...]

    def with_points(self, more: Iterable[Point]) -> "Lot":
        """With those that it does not have yet."""
        return replace(self, points=tuple(dict.fromkeys((*self.points, *more))))

    @cached_property
    def keys(self) -> dict[Point, str]:
        """Of each point in a store."""
        shared = fingerprint(self.conditions)
        return {point: key_of(shared, self.damping_ns_per_m, point) for point in self.points}

    def missing(self, store: TrialStore) -> list[Point]:
        """Points that the store has not."""
        return [point for point, key in self.keys.items() if key not in store.known]

    def known(self, store: TrialStore) -> list[Outcome]:
        """What the store has of it."""
        return [restored(store.known[key]) for key in self.keys.values() if key in store.known]

    def keep(self, store: TrialStore, outcomes: Iterable[Outcome]) -> None:
        """Store outcomes of it. ConfigError as `TrialStore.add`."""
        store.add((self.keys[outcome.environment], kept(outcome)) for outcome in outcomes)


def make(lot: Lot, store: TrialStore, tell: Progress, pool: Executor, hear: Hear) -> int:
    """Fly what the store has not, and how many those are; `hear` gets the outcomes of each task."""
    missing = lot.missing(store)
    tasks = [np.array(missing[first : first + TOGETHER]) for first in range(0, len(missing), TOGETHER)]
    done, what = len(lot.points) - len(missing), f"trials, added damping {lot.damping_ns_per_m:g} N s/m"
    tell(what, done, len(lot.points))
    for outcomes in _flown(lot, tasks, pool):
        lot.keep(store, outcomes)
        done += len(outcomes)
        tell(what, done, len(lot.points))
        hear(outcomes)
    return len(missing)


def _flown(lot: Lot, tasks: list[Floats], pool: Executor) -> Iterator[list[Outcome]]:
    """Outcomes of tasks as they finish; what has not begun is given up when the caller stops."""
    waiting: list[Future[list[Outcome]]] = [pool.submit(fly, lot.conditions, lot.damping_ns_per_m, task) for task in tasks]
    try:
        for future in as_completed(waiting):
            yield future.result()
    finally:
        for future in waiting:
            future.cancel()
