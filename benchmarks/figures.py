"""One measured number and its judgement, and the list of them in build/bench.json.

A target is text that people read and `judge` parses:

    '<= 1.25x', '>= 30x'   the ratio to the yardstick of the same run: what says something on any
                           machine
    '<= 25'                the value itself: counts and bytes, which no neighbour changes
    'p >= 0.01'            the probability of so many more events than the yardstick has, if both
                           had the same rate
    ''                     nothing: the figure is told as information

The ratio is value / reference; for a speed-up, where both are times, the caller gives it the other
way round. What would break it: a time judged by its value, since another machine of the same kind
then misses by its speed alone.
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

    `note` says why there is no value, or what the machine refused; `p` only where a target asks for
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
        """The row; a note and p only where there is something to say."""
        return {
            key: value
            for key, value in asdict(self).items()
            if key not in ("note", "p") or value not in ("", None)
        }


def judge(
    target: str, value: float | None, ratio: float | None, p: float | None = None
) -> bool | None:
    """Whether `target` is reached; None where there is none.

    ValueError for a target that is not '<= number' or '>= number', with an x behind it or a p
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
    """The figure for `value`, judged alone, by `ratio` (value / reference unless given) or by
    `p`.
    """
    if ratio is None and reference:
        ratio = value / reference
    return Figure(
        name, value, unit, reference, ratio, target, judge(target, value, ratio, p), note, p
    )


def refused(name: str, target: str, note: str) -> Figure:
    """The figure that could not be measured; `note` says why and what to do."""
    return Figure(name, None, "", None, None, target, False, note)


def merge(old: Iterable[dict[str, Any]], new: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """`old` rows in their order with those that were measured again replaced, then the rows
    that are new.
    """
    fresh = {row["name"]: row for row in new}
    kept = [fresh.pop(row["name"], row) for row in old]
    return kept + list(fresh.values())


def load(path: Path) -> list[dict[str, Any]]:
    """Rows of an earlier run; none if there is no file or it is not ours."""
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
    """Write `rows` whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(path.name + ".new")
    fresh.write_text(json.dumps(rows, indent=1) + "\n")
    fresh.replace(path)
