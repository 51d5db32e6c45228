"""One measured number and its judgement, and the list of them in build/bench.json.

A target is text that people read and `judge` parses: '<= 1.25x' and '>= 30x' judge the ratio, '<= 25' judges the value.
The ratio is value / reference; for a speed-up, where both are times, the caller gives it the other way round.
"""

import json
import math
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

_TARGET = re.compile(r"(<=|>=)\s*(-?\d+(?:\.\d+)?)\s*(x?)")


@dataclass(frozen=True)
class Figure:
    """A row of build/bench.json; `note` says why there is no value, or what the machine refused."""

    name: str
    value: float | None
    unit: str
    reference: float | None
    ratio: float | None
    target: str
    ok: bool
    note: str = ""

    def plain(self) -> dict[str, Any]:
        """The row; a note only where there is something to say."""
        return {key: value for key, value in asdict(self).items() if key != "note" or value}


def judge(target: str, value: float | None, ratio: float | None) -> bool:
    """Whether `target` is reached. ValueError for a target that is not '<= number', '>= number', either with an x."""
    found = _TARGET.match(target)
    if found is None:
        raise ValueError(f"target {target!r}: write '<= 25', '<= 1.25x' or '>= 30x'")
    sense, limit, of_ratio = found[1], float(found[2]), bool(found[3])
    measured = ratio if of_ratio else value
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
) -> Figure:
    """The figure for `value`, judged alone or by `ratio` (value / reference unless given)."""
    if ratio is None and reference:
        ratio = value / reference
    return Figure(name, value, unit, reference, ratio, target, judge(target, value, ratio), note)


def refused(name: str, target: str, note: str) -> Figure:
    """The figure that could not be measured; `note` says why and what to do."""
    return Figure(name, None, "", None, None, target, False, note)


def merge(old: Iterable[dict[str, Any]], new: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """`old` rows in their order with those that were measured again replaced, then the rows that are new."""
    fresh = {row["name"]: row for row in new}
    kept = [fresh.pop(row["name"], row) for row in old]
    return kept + list(fresh.values())


def load(path: Path) -> list[dict[str, Any]]:
    """Rows of an earlier run; none if there is no file or it is not ours."""
    try:
        rows = json.loads(path.read_text())
    except (OSError, ValueError):
        return []
    return [row for row in rows if isinstance(row, dict) and "name" in row] if isinstance(rows, list) else []


def save(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write `rows` whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(path.name + ".new")
    fresh.write_text(json.dumps(rows, indent=1) + "\n")
    fresh.replace(path)
