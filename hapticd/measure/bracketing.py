"""Limits along axes are closed in on round by round, all of them side by side.

A round is one task: values about the predicted limit, then outwards as long as none or all fail, then between the last that
passed and the first that failed. What the next round of a limit is depends on the one before, so each has one task under way;
the cores are kept busy by the other limits. The rounds of a limit, and so its value, do not depend on who else is under way,
nor on which of its trials a store has already: those are learnt without being made again.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass, field
from math import nan

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.measure.lots import Lot
from hapticd.measure.outcomes import Conditions, Outcome
from hapticd.measure.store import TrialStore

REACH = (2e4, 60.0, -0.25)  # of a predicted search: N/m, Ns/m, kg
FIRST = (0.6, 1.5)  # of the predicted limit: where the first round looks
OUTWARDS = 2.5
ROUNDS = 5
ROUND = 16  # values
COARSE = 0.15  # of the limit: a step that one more round makes fine enough
UNPREDICTED = 0.02  # of the reach, where the prediction has no limit to look near

Fly = Callable[[Conditions, float, Floats], list[Outcome]]
Tell = Callable[["Bracketing", list[Outcome], bool], None]


@dataclass(frozen=True, slots=True)
class Scan:
    """One limit to be found."""

    axis: int
    damping_ns_per_m: float
    amplitude: float
    predicted: float


@dataclass(frozen=True, eq=False)
class Bracketing:
    """A scan with one noise; `tried` grows, in order of the axis."""

    scan: Scan
    conditions: Conditions
    tried: list[Outcome] = field(default_factory=list)

    def rounds(self) -> Iterator[Lot]:
        """What to try next, until the limit is known to 1 %; each round has to be learnt before the next."""
        for values in _rounds(self.scan, self.tried):
            points = np.zeros((len(values), 3))
            points[:, self.scan.axis] = values
            yield Lot(self.conditions, self.scan.damping_ns_per_m, tuple((k, b, m) for k, b, m in points.tolist()))

    def learn(self, outcomes: Iterable[Outcome]) -> None:
        """Take the outcomes of a round."""
        self.tried.extend(outcomes)
        self.tried.sort(key=lambda outcome: abs(outcome.environment[self.scan.axis]))


def bracket_all(wanted: list[Bracketing], store: TrialStore, pool: Executor, flying: Fly, tell: Tell) -> None:
    """Run them to their end. `tell` gets each round's new outcomes, none where the store had all that is left of a limit, and
    whether it was the last; if it raises, the rest is given up.
    """
    rounds = {one: one.rounds() for one in wanted}
    waiting: dict[Future[list[Outcome]], tuple[Bracketing, Lot]] = {}

    def goes_on(one: Bracketing) -> bool:
        for lot in rounds[one]:
            one.learn(lot.known(store))
            if missing := lot.missing(store):
                waiting[pool.submit(flying, lot.conditions, lot.damping_ns_per_m, np.array(missing))] = one, lot
                return True
        return False

    try:
        for one in wanted:
            if not goes_on(one):
                tell(one, [], True)
        while waiting:
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                (one, lot), outcomes = waiting.pop(future), future.result()
                lot.keep(store, outcomes)
                one.learn(outcomes)
                tell(one, outcomes, not goes_on(one))
    finally:
        for future in waiting:
            future.cancel()


def bracket(axis: int, tried: list[Outcome]) -> tuple[float, float]:
    """Last value that passed before the first that failed, and that; nan where there is none."""
    failed = next((place for place, outcome in enumerate(tried) if not outcome.passes), None)
    last = (tried if failed is None else tried[:failed])[-1:]
    return (
        last[0].environment[axis] if last else nan,
        nan if failed is None else tried[failed].environment[axis],
    )


def _rounds(scan: Scan, tried: list[Outcome]) -> Iterator[Floats]:
    """Values to try next; `tried` grows meanwhile."""
    near = scan.predicted if np.isfinite(scan.predicted) and scan.predicted != 0.0 else UNPREDICTED * REACH[scan.axis]
    low, high = FIRST[0] * near, FIRST[1] * near
    yield np.concatenate(([0.0], np.linspace(low, high, ROUND - 1)))
    for _ in range(ROUNDS):
        passed, failed = bracket(scan.axis, tried)
        if np.isnan(passed):
            return
        if np.isnan(failed):
            yield np.linspace(passed, OUTWARDS * passed if passed else high, ROUND + 1)[1:]
        elif abs(failed - passed) > COARSE * abs(failed):
            yield np.linspace(passed, failed, ROUND + 2)[1:-1]
        else:
            break
    passed, failed = bracket(scan.axis, tried)
    if np.isfinite(passed) and np.isfinite(failed):
        yield np.linspace(passed, failed, ROUND + 2)[1:-1]
