"""One measured number and its judgement, and the list of them in build/bench.json.

A target is text for people that `judge` parses:

    '<= 1.25x', '>= 30x'   the ratio to the yardstick of the same run: meaningful on any machine
    '<= 25'                the value itself: counts and bytes, independent of other load
    'p >= 0.01'            the probability of at least that many more events than the yardstick's,
                           if both had the same rate
    ''                     none: the figure is information

The ratio is value / reference; for a speed-up, where both are times, the caller passes the inverse.
Limitations: a time judged by its value, since another machine of the same kind then misses by its
speed alone.
"""

import json
import math
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

_TARGET = re.compile(r"(p\s*)?(<=|>=)\s*(-?\d+(?:\.\d+)?)\s*(x?)")


@dataclass(frozen=True)
class Figure:
    """A row of build/bench.json; `ok` is None for information.

    `note` gives the reason for a missing value, or the refused rights; `p` only if a target needs
    it. `reference` is the number of the `yardstick`; that and `reason` come from the table of
    targets.
    """

    name: str
    value: float | None
    unit: str
    reference: float | None
    ratio: float | None
    target: str
    ok: bool | None
    note: str = ""
    p: float | None = None
    yardstick: str = ""
    reason: str = ""

    def plain(self) -> dict[str, Any]:
        """Return the row; note and p only if they are set."""
        return {
            key: value
            for key, value in asdict(self).items()
            if key not in ("note", "p") or value not in ("", None)
        }


def judge(
    target: str, value: float | None, ratio: float | None, p: float | None = None
) -> bool | None:
    """Return whether `target` is reached; None without one.

    ValueError for a target that is not '<= number' or '>= number', with an optional x after it or p
    before it.
    """
    if not target:
        return None
    found = _TARGET.match(target)
    if found is None:
        raise ValueError(f"target {target!r}: write '<= 25', '<= 1.25x', '>= 30x' or 'p >= 0.01'")
    of_p = bool(found[1])
    sense = found[2]
    limit = float(found[3])
    of_ratio = bool(found[4])
    measured = p if of_p else ratio if of_ratio else value
    if measured is None or math.isnan(measured):
        return False
    return measured <= limit if sense == "<=" else measured >= limit


def compared(
    name: str,
    target: str,
    value: float,
    unit: str,
    reference: float | None = None,
    note: str = "",
    ratio: float | None = None,
    p: float | None = None,
) -> Figure:
    """Return the figure for `value`, judged alone, by `ratio` (value / reference unless given) or
    by `p`.
    """
    if ratio is None and reference:
        ratio = value / reference
    return Figure(
        name, value, unit, reference, ratio, target, judge(target, value, ratio, p), note, p
    )


def refused(name: str, target: str, note: str) -> Figure:
    """Return the figure that could not be measured; `note` gives the reason and the remedy."""
    return Figure(name, None, "", None, None, target, False, note)


def merge(old: Iterable[dict[str, Any]], new: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the `old` rows in their order, replaced by new measurements, then the added rows."""
    fresh = {row["name"]: row for row in new}
    kept = [fresh.pop(row["name"], row) for row in old]
    return kept + list(fresh.values())


def load(path: Path) -> list[dict[str, Any]]:
    """Return the rows of an earlier run; none without a valid file."""
    try:
        rows = json.loads(path.read_text())
    except (OSError, ValueError):
        return []
    return (
        [row for row in rows if isinstance(row, dict) and "name" in row]
        if isinstance(rows, list)
        else []
    )


def save(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write `rows` completely or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(path.name + ".new")
    fresh.write_text(json.dumps(rows, indent=1) + "\n")
    fresh.replace(path)
