"""Measure the targets, print the results, and write build/bench.json.

    python benchmarks/run.py                         everything but the parts in BY_NAME
    python benchmarks/run.py --only wake,tick        those parts; their figures replace those of an
                                                     earlier run
    python benchmarks/run.py --only new              a group of parts, see GROUPS
    python benchmarks/run.py --repeat 5 --only new   five times, and for each figure its values, the
                                                     worst, and 1.3 times that
    python benchmarks/run.py --page                  the table of targets, as it is in
                                                     docs/development/benchmarks.md

A part is a module of this folder with TARGETS (names and targets of its figures) and `measure()`,
which yields figures as they become known. An impossible measurement is a figure that is not ok,
with the reason.
"""

import argparse
import importlib
import os
import subprocess
import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from rich.console import Console
from rich.table import Table

from benchmarks import targets
from benchmarks.figures import Figure, load, merge, refused, save
from benchmarks.interpreter import this_interpreter
from benchmarks.worker import BenchError
from hapticd.core.errors import HapticdError

PARTS = tuple(targets.TABLE)
GROUPS = {  # parts whose figures belong together
    "new": (
        "tick",
        "late",
        "telemetry",
        "lockstep",
        "record",
        "trials",
        "board",
        "fused",
        "predict_map",
        "map_6384",
    ),
    "servo": (
        "wake",
        "tick",
        "late",
        "latency",
        "cli_verbs",
        "page_cpu",
        "page_seen",
        "guard",
        "guard_cpu",
        "telemetry",
        "lockstep",
        "process",
        "record",
        "board",
    ),
    "trials": (
        "engine",
        "trials",
        "spa",
        "fused",
        "predict_map",
        "map_6384",
        "directed",
        "timing",
        "executors",
    ),
}
BY_NAME = frozenset({"guard_attack", "blind"})  # each takes as long as all the others together
LOOSEST = 1.3  # times the worst of some runs: no target may be looser
OUTPUT = Path(__file__).resolve().parents[1] / "build" / "bench.json"
VERDICTS = {True: "[green]passed[/]", False: "[red]missed[/]", None: "information"}
console = Console()


def measure(part: str) -> list[Figure]:
    """Return all figures of `part`, in the order of its TARGETS; missing ones have their reason."""
    module = importlib.import_module(f"benchmarks.{part}")
    found: dict[str, Figure] = {}
    reason = "not measured"
    try:
        for figure in module.measure():
            found[figure.name] = figure
    except (BenchError, HapticdError, OSError, subprocess.SubprocessError) as error:
        reason = str(error)
    rows = [
        found.get(name) or refused(name, target, reason) for name, target in module.TARGETS.items()
    ]
    return [_explained(figure, targets.TABLE.get(part, {})) for figure in rows]


def _explained(figure: Figure, rows: dict[str, targets.Target]) -> Figure:
    """Add yardstick and reason from the table."""
    row = rows.get(figure.name)
    return figure if row is None else replace(figure, yardstick=row.yardstick, reason=row.reason)


def chosen(only: str) -> list[str]:
    """Return the parts and groups in `only`, separated by commas or blanks; by default all but
    those of BY_NAME. SystemExit for an unknown one.
    """
    names = only.replace(",", " ").split()
    unknown = [name for name in names if name not in PARTS and name not in GROUPS]
    if unknown:
        raise SystemExit(
            f"no part {unknown[0]!r}; parts: {', '.join(PARTS)}; groups: {', '.join(GROUPS)}"
        )
    wanted = {part for name in names for part in GROUPS.get(name, (name,))}
    return [part for part in PARTS if part in (wanted if names else set(PARTS) - BY_NAME)]


def table(rows: list[dict[str, Any]]) -> Table:
    """Return `rows` of build/bench.json as a table; notes are below."""
    drawn = Table(title="hapticd benchmarks", title_justify="left")
    drawn.add_column("name", no_wrap=True)
    for heading in ("value", "yardstick", "ratio"):
        drawn.add_column(heading, justify="right", no_wrap=True)
    drawn.add_column("target")
    drawn.add_column("")
    for row in rows:
        unit = row["unit"]
        numbers = (
            _number(row["value"], unit),
            _number(row["reference"], unit),
            _number(row["ratio"], "x"),
        )
        drawn.add_row(row["name"], *numbers, row["target"], VERDICTS[row["ok"]])
    return drawn


def _number(number: Any, unit: str) -> str:
    return "" if number is None else f"{number:.4g} {unit}".strip()


def judged(row: dict[str, Any]) -> float | None:
    """Return the number of a row that its target judges."""
    found: float | None = (
        row.get("p")
        if row["target"].startswith("p")
        else row["ratio"]
        if "x" in row["target"]
        else row["value"]
    )
    return found


def worst(target: str, values: Iterable[float | None]) -> float | None:
    """Return the worst result of some runs; None if one of them has none."""
    found = list(values)
    if not found or None in found:
        return None
    return min(found) if ">=" in target else max(found)  # type: ignore[type-var]


def loosest(target: str, value: float | None) -> float | None:
    """Return the loosest permitted target for a worst run of `value`."""
    if value is None or target.startswith("p"):
        return None
    return value / LOOSEST if ">=" in target else value * LOOSEST


def spread(runs: list[list[dict[str, Any]]]) -> Table:
    """Return the results of some runs: each judged number, the worst, and the loosest permitted
    target.
    """
    drawn = Table(title=f"{len(runs)} runs", title_justify="left")
    for heading in ("name", "target", "found", "worst", f"{LOOSEST}x worst"):
        drawn.add_column(heading, no_wrap=heading != "found")
    for rows in zip(*runs, strict=True):
        name = rows[0]["name"]
        target = rows[0]["target"]
        found = [judged(row) for row in rows]
        most = worst(target, found)
        drawn.add_row(
            name,
            target,
            " ".join(_number(one, "") or "-" for one in found),
            _number(most, ""),
            _number(loosest(target, most), ""),
        )
    return drawn


def main(arguments: list[str]) -> int:
    """Measure, write after each part, print; the exit code is 0 also for a missed target, which the
    file records.
    """
    parser = argparse.ArgumentParser(
        description="measure hapticd against its targets", allow_abbrev=False
    )
    parts_help = (
        f"parts, of {', '.join(PARTS)}, or groups, of {', '.join(GROUPS)} (default: $ONLY, else"
        " all)"
    )
    parser.add_argument("--only", default=os.environ.get("ONLY", ""), help=parts_help)
    parser.add_argument(
        "--repeat", type=int, default=1, help="run so often and print the worst of each figure"
    )
    parser.add_argument(
        "--page", action="store_true", help="print the table of targets in Markdown and end"
    )
    parser.add_argument("--output", type=Path, default=OUTPUT)
    asked = parser.parse_args(arguments)
    if asked.page:
        sys.stdout.write(targets.page())
        return 0
    runs = [_run(chosen(asked.only), bool(asked.only), asked.output) for _ in range(asked.repeat)]
    if asked.repeat > 1:
        console.print(spread(runs))
    return 0


def _run(parts: list[str], some: bool, output: Path) -> list[dict[str, Any]]:
    """Return the rows of one run, which are written and printed."""
    rows = load(output) if some else []
    measured: list[dict[str, Any]] = []
    build = this_interpreter().text
    for part in parts:
        console.print(f"{part} ...", end=" ")
        begin = time.monotonic()
        measured += [{**figure.plain(), "interpreter": build} for figure in measure(part)]
        console.print(f"{time.monotonic() - begin:.0f} s")
        save(output, merge(rows, measured))
    console.print(build)
    console.print(table(measured))
    for note in dict.fromkeys(row["note"] for row in measured if "note" in row):
        names = ", ".join(row["name"] for row in measured if row.get("note") == note)
        console.print(f"{names}: {note}", style="dim", highlight=False, markup=False)
    ruled = [row for row in measured if row["ok"] is not None]
    passed = sum(bool(row["ok"]) for row in ruled)
    console.print(
        f"{passed} of {len(ruled)} passed, {len(ruled) - passed} missed; written to {output}"
    )
    return measured


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
