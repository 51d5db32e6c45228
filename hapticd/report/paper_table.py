"""The table of `reproduce`: a column for each device, as text, as Markdown and as JSON."""

from collections.abc import Iterable
from math import isfinite
from typing import Any

from hapticd.measure.reproduce_rows import PRINTED, Row, by_quantity
from hapticd.report.table import Table, shown, table

COLUMNS = ("quantity", "unit", "paper")


def paper_table(rows: Iterable[Row]) -> Table:
    """Ours for each device beside the paper; in brackets the difference, after +- one sd between seeds."""
    found = list(rows)
    devices = [name for name in dict.fromkeys(row.device for row in found) if name != PRINTED]
    lines = []
    for quantity, by_device in by_quantity(found).items():
        first = next(iter(by_device.values()))
        kinds = ", ".join(dict.fromkeys(row.kind for row in by_device.values()))
        cells = [_cell(by_device.get(name, by_device.get(PRINTED))) for name in devices]
        lines.append([quantity, first.unit, _number(first.paper), *cells, kinds])
    return table([*COLUMNS, *devices, "kind"], lines)


def notes(rows: Iterable[Row]) -> list[str]:
    """What does not match or needs saying, once each."""
    return list(dict.fromkeys(f"{row.quantity}, {row.device}: {row.note}" for row in rows if row.note))


def as_json(rows: Iterable[Row]) -> list[dict[str, Any]]:
    """Objects with null where there is no number."""
    return [
        {
            "quantity": row.quantity, "paper": _or_none(row.paper), "ours": _or_none(row.ours), "unit": row.unit, "kind": row.kind,
            "device": row.device, "sd": _or_none(row.sd), "difference": _or_none(row.difference), "seeds": row.seeds,
            "predicted": _or_none(row.predicted), "note": row.note,
        }
        for row in rows
    ]  # fmt: skip


def markdown(content: Table) -> str:
    """The same table for a page."""
    lines = [content.columns, tuple("---" for _ in content.columns), *content.rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines) + "\n"


def _cell(row: Row | None) -> str:
    if row is None or not isfinite(row.ours):
        return "-"
    spread = f" ± {shown(float(f'{row.sd:.2g}'))}" if isfinite(row.sd) else ""
    differs = f" ({100.0 * row.difference:+.1f} %)" if isfinite(row.difference) else ""
    return f"{shown(float(row.ours))}{spread}{differs}"


def _number(value: float) -> str:
    return shown(float(value))


def _or_none(value: float) -> float | None:
    return float(value) if isfinite(value) else None
