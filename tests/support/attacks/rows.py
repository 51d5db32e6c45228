"""A row of the attack suite: what is tried, what has to come of it, and what would show a loss.

A row counts two things: what was `tried`, and what was `lost` by its own counter, which has to stay
at 0. That the counter counts is a test of its own: one loss is injected, and it has to rise
(`test_attacks`). Numbers that say how far away the end was (a longest time to stop, the memory that
came) are `figures`; the largest of all parts of a row counts. A row that draws its pieces from
kinds counts how often each of them `came`: in a whole run at least LEAST times.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

NOTED = 8  # losses that are described; all are counted
LEAST = 20  # times that every kind comes in a whole run


@dataclass(frozen=True)
class Outcome:
    """What an attack came to."""

    tried: int
    lost: int = 0
    found: tuple[str, ...] = ()  # what was lost, in words
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
    """Counts what was lost."""

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
    """One line of the table. `attack(times, seed)` tries `times` pieces, the same for the same
    seed where nothing but the seed decides.
    """

    name: str
    does: str
    expected: str
    counter: str
    unit: str  # of what is tried
    times: int  # of a whole run
    short: int  # of the run that continuous integration makes
    attack: Callable[[int, int], Outcome]
    part: int = 0  # pieces that one process tries at once; 0: all, and nothing else beside it
