"""Tables as text: columns with units, numbers to three digits, aligned; and formatted shares and
durations.

A column of numbers and words is aligned as words.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import inf, isnan
from textwrap import wrap

from hapticd.core.units import percent

__all__ = ["Cell", "Table", "changed", "duration", "shown", "table", "text"]

DIGITS = 3
WIDEST_LAST = 70  # characters of the last column
GAP = "  "
NONE = 1e-6  # a relative change that is only rounding

Cell = str | float


@dataclass(frozen=True, slots=True)
class Table:
    """`columns` are names, with their unit where they have one; a row has a cell for each."""

    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    title: str = ""


def table(columns: Iterable[str], rows: Iterable[Iterable[Cell]], title: str = "") -> Table:
    """Return a table from any iterables."""
    return Table(tuple(columns), tuple(tuple(row) for row in rows), title)


def text(content: Table) -> str:
    """Format the table, numbers right-aligned, words left-aligned, long words of the last column in
    several lines.
    """
    cells = [content.columns, *([shown(cell) for cell in row] for row in content.rows)]
    numeric = [
        all(not isinstance(row[place], str) for row in content.rows)
        for place in range(len(content.columns))
    ]
    broken = [_broken(row) for row in cells]
    widths = [
        max(len(line[place]) for block in broken for line in block)
        for place in range(len(content.columns))
    ]
    ruler = [["-" * width for width in widths]]
    lines = [line for block in (broken[0], ruler, *broken[1:]) for line in block]
    return "\n".join(
        [
            *([content.title] if content.title else []),
            *(_aligned(line, widths, numeric) for line in lines),
        ]
    )


def shown(cell: Cell) -> str:
    """Format a number to three digits; "-" for nan."""
    if isinstance(cell, str):
        return cell
    if isnan(cell):
        return "-"
    return f"{cell:.{DIGITS}g}" if abs(cell) < 1000.0 else f"{cell:,.0f}"


def changed(share: float) -> str:
    """Format a relative change."""
    if share == inf:
        return "all"
    if share < NONE:
        return "0 %"
    return percent(share)


def duration(seconds: float) -> str:
    """Format seconds with a suitable prefix."""
    if isnan(seconds):
        return "-"
    for factor, unit in ((1.0, "s"), (1e3, "ms"), (1e6, "us")):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def _broken(row: Sequence[str]) -> list[list[str]]:
    """Return the lines of a row: its last cell is wrapped."""
    first, *more = wrap(row[-1], WIDEST_LAST) or [""]
    blank = [""] * (len(row) - 1)
    return [[*row[:-1], first], *([*blank, line] for line in more)]


def _aligned(line: Sequence[str], widths: Sequence[int], numeric: Sequence[bool]) -> str:
    return GAP.join(
        cell.rjust(width) if right else cell.ljust(width)
        for cell, width, right in zip(line, widths, numeric, strict=True)
    ).rstrip()
