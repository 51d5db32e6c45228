"""The rows as a table: a column for each device, as text, as Markdown, as JSON, and back.

A cell contains our value, one standard deviation between seeds, the difference from the paper and,
in square brackets, the number of the note below the table. Each note is listed once, with its
quantities.

All rows of one quantity must have one unit; the unit column shows the first.
"""

from collections.abc import Iterable, Mapping
from dataclasses import fields
from math import isfinite, nan
from typing import Any

from examples.weir2008.rows import PRINTED, PaperRow, by_quantity
from hapticd.zwidth.report.paper import Table, shown, table
from hapticd.zwidth.store import to_json

__all__ = ["as_json"]

MANY = 10.0  # from here on a relative difference is written as a ratio
COLUMNS = ("quantity", "unit", "paper")
OF_A_ROW = (
    "quantity",
    "paper",
    "ours",
    "unit",
    "kind",
    "device",
    "sd",
    "difference",
    "seeds",
    "predicted",
    "note",
    "part",
)


def paper_table(rows: Iterable[PaperRow]) -> Table:
    """Compare ours for each device with the paper: +- one sd between seeds, the difference, and the
    number of its note.
    """
    found = list(rows)
    devices = _devices(found)
    numbers = _numbers(found)
    lines = []
    for quantity, by_device in by_quantity(found).items():
        first = next(iter(by_device.values()))
        cells = [_cell(by_device.get(name, by_device.get(PRINTED)), numbers) for name in devices]
        seeds = str(first.seeds or "-")
        lines.append(
            [quantity, first.unit, shown(float(first.paper)), *cells, seeds, _kinds(by_device)]
        )
    return table(
        [*COLUMNS, *("ours" if name == PRINTED else name for name in devices), "seeds", "kind"],
        lines,
    )


def readings_table(axis: Iterable[PaperRow], whole: Iterable[PaperRow]) -> Table:
    """Return axis and set reading of each limit and ratio in adjacent columns; `whole` has the
    names of `axis` with `_set` in them.
    """
    along = by_quantity(axis)
    over = by_quantity(whole)
    numbers = _numbers([row for by_device in over.values() for row in by_device.values()])
    devices = _devices([row for by_device in over.values() for row in by_device.values()])
    lines = []
    for quantity, by_device in over.items():
        beside = along[quantity.replace("_set", "")]
        first = next(iter(by_device.values()))
        pairs = [
            cell
            for name in devices
            for cell in (_cell(beside[name], {}), _cell(by_device[name], numbers))
        ]
        lines.append([quantity.replace("_set", ""), first.unit, shown(float(first.paper)), *pairs])
    return table(
        [*COLUMNS, *(f"{name}, {reading}" for name in devices for reading in ("axis", "set"))],
        lines,
    )


def notes(rows: Iterable[PaperRow]) -> list[str]:
    """Return the reasons of differences and other notes, once each, by the numbers in the table."""
    found = list(rows)
    lines = []
    for note, number in _numbers(found).items():
        about = [row for row in found if row.note == note]
        quantities, devices = (
            ", ".join(dict.fromkeys(names))
            for names in zip(*((r.quantity, r.device) for r in about), strict=True)
        )
        lines.append(
            f"[{number}] {quantities}{'' if devices == PRINTED else f' of {devices}'}: {note}"
        )
    return lines


def as_json(rows: Iterable[PaperRow]) -> list[dict[str, Any]]:
    """Return objects with null for missing numbers."""
    return [{name: to_json(getattr(row, name)) for name in OF_A_ROW} for row in rows]


def from_json(content: Iterable[Mapping[str, Any]]) -> tuple[PaperRow, ...]:
    """Return the rows from JSON values."""
    known: Iterable[dict[str, Any]] = (
        {name: nan if value is None else value for name, value in each.items()} for each in content
    )
    return tuple(
        PaperRow(**{field.name: values[field.name] for field in fields(PaperRow)})
        for values in known
    )


def markdown(content: Table) -> str:
    """Return the same table for a page."""
    lines = [content.columns, tuple("---" for _ in content.columns), *content.rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines) + "\n"


def _devices(rows: list[PaperRow]) -> list[str]:
    """Return the devices in order; `paper` only if there is no other."""
    every = list(dict.fromkeys(row.device for row in rows))
    return [name for name in every if name != PRINTED] or every


def _numbers(rows: Iterable[PaperRow]) -> dict[str, int]:
    """Return {note: its number} in order."""
    known = dict.fromkeys(
        row.note
        for by_device in by_quantity(rows).values()
        for row in by_device.values()
        if row.note
    )
    return {note: number for number, note in enumerate(known, 1)}


def _kinds(by_device: Mapping[str, PaperRow]) -> str:
    """Return the kind, and the devices of another kind."""
    kinds = {name: row.kind for name, row in by_device.items()}
    first = next(iter(kinds.values()))
    return "; ".join([first, *(f"{name} {kind}" for name, kind in kinds.items() if kind != first)])


def _cell(row: PaperRow | None, numbers: Mapping[str, int]) -> str:
    if row is None:
        return ""
    mark = f" [{numbers[row.note]}]" if row.note in numbers else ""
    if not isfinite(row.ours):
        return f"-{mark}"
    spread = f" ± {shown(float(f'{row.sd:.2g}'))}" if isfinite(row.sd) else ""
    return f"{shown(float(row.ours))}{spread}{_differs(row.difference)}{mark}"


def _differs(relative: float) -> str:
    if not isfinite(relative):
        return ""
    return f" ({100.0 * relative:+.1f} %)" if relative < MANY else f" (x {relative + 1.0:,.0f})"
