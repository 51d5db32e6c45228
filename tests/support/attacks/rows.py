"""A row of the attack suite: the attack, the expected result, and the counter that shows a loss.

A row counts the pieces `tried`, and those `lost` by its own counter, which has to stay at 0. A
separate test (`test_attacks`) injects one loss, and the counter has to rise. Distances from a
failure (the longest time to stop, the growth of memory) are `figures`; the largest of all parts of
a row counts. A row that draws its pieces from kinds counts how often each kind `came`: in a whole
run at least LEAST times.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

NOTED = 8  # losses that are described; all are counted
LEAST = 20  # occurrences of every kind in a whole run


@dataclass(frozen=True)
class Outcome:
    """The result of an attack."""

    tried: int
    lost: int = 0
    found: tuple[str, ...] = ()  # descriptions of the losses
    figures: dict[str, float] = field(default_factory=dict)
    came: Counter[str] = field(default_factory=Counter)  # by kind

    def __add__(self, other: "Outcome") -> "Outcome":
        names = self.figures | other.figures
        figures = {
            name: max(one.figures[name] for one in (self, other) if name in one.figures)
            for name in names
        }
        found = (*self.found, *other.found)[:NOTED]
        tried, lost = self.tried + other.tried, self.lost + other.lost
        return Outcome(tried, lost, found, figures, self.came + other.came)


class Losses:
    """A counter of losses."""

    def __init__(self) -> None:
        self.count = 0
        self.found: list[str] = []

    def add(self, what: str) -> None:
        """One loss."""
        self.count += 1
        if len(self.found) < NOTED:
            self.found.append(what)

    def outcome(self, tried: int, **figures: float) -> Outcome:
        """Of `tried` pieces."""
        return Outcome(tried, self.count, tuple(self.found), figures)


class Row(NamedTuple):
    """One row of the table. `attack(times, seed)` tries `times` pieces, the same for the same seed
    where only the seed decides.
    """

    name: str
    does: str
    expected: str
    counter: str
    unit: str  # unit of `times`
    times: int  # in a whole run
    short: int  # in the run of continuous integration
    attack: Callable[[int, int], Outcome]
    part: int = 0  # pieces that one process tries at once; 0: all, without other processes
