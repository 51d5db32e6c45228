"""Settings side by side: what one costs, how wrong it is, and where paying more stops to help.

The knee of a sweep is its cheapest setting whose total error is within 10 % of the best one's: what costs more buys little. A
knee at the far end says that the sweep has none, more would still help.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import inf, isnan

TOLERANCE = 1.1


@dataclass(frozen=True, slots=True)
class Row:
    """One setting: seconds for one trial, its errors (see `gauge`), whether it is the default, and whether the knee."""

    sweep: str
    label: str
    seconds: float
    step: float
    total: float
    default: bool = False
    knee: bool = False
    note: str = ""


def with_knees(rows: list[Row]) -> Iterable[Row]:
    """`rows` with the knee of every sweep marked; effects have none."""
    chosen = {sweep: knee([row for row in rows if row.sweep == sweep]) for sweep in {row.sweep for row in rows} - {"effect"}}
    for row in rows:
        yield replace(row, knee=row is chosen.get(row.sweep))


def knee(rows: Iterable[Row]) -> Row | None:
    """The cheapest of `rows` whose total error is within 10 % of the least; None if none was measured."""
    known = [row for row in rows if not isnan(row.seconds) and row.total < inf]  # nan is not less
    if not known:
        return None
    best = min(row.total for row in known)
    return min((row for row in known if row.total <= TOLERANCE * best), key=lambda row: row.seconds)
