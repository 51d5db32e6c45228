"""Measure what must be reached, print it, and write build/bench.json.

    python benchmarks/run.py                     everything
    python benchmarks/run.py --only wake,tick    those parts; their figures replace those of an earlier run

A part is a module of this folder with TARGETS (names and targets of its figures) and `measure()`, which yields figures
as they become known. What cannot be measured is a figure that is not ok and says why.
"""

import argparse
import importlib
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from rich.console import Console
from rich.table import Table

from benchmarks.figures import Figure, load, merge, refused, save
from benchmarks.worker import BenchError
from hapticd.errors import HapticdError

PARTS = (
    "wake", "tick", "late", "latency", "telemetry", "lockstep", "process", "record", "engine", "trials",
    "board", "spa", "fused", "predict_map", "map_6384", "directed", "executors",
)  # fmt: skip
OUTPUT = Path(__file__).resolve().parents[1] / "build" / "bench.json"
console = Console()


def measure(part: str) -> list[Figure]:
    """All figures of `part`, in the order of its TARGETS; those it could not measure say why."""
    module = importlib.import_module(f"benchmarks.{part}")
    found: dict[str, Figure] = {}
    reason = "not measured"
    try:
        for figure in module.measure():
            found[figure.name] = figure
    except (BenchError, HapticdError, OSError, subprocess.SubprocessError) as error:
        reason = str(error)
    return [found.get(name) or refused(name, target, reason) for name, target in module.TARGETS.items()]


def chosen(only: str) -> list[str]:
    """Parts named in `only`, separated by commas or blanks; all if it names none. SystemExit for an unknown one."""
    names = only.replace(",", " ").split()
    unknown = [name for name in names if name not in PARTS]
    if unknown:
        raise SystemExit(f"no part {unknown[0]!r}; parts: {', '.join(PARTS)}")
    return names or list(PARTS)


def table(rows: list[dict[str, Any]]) -> Table:
    """`rows` of build/bench.json for people; notes stand below."""
    drawn = Table(title="hapticd benchmarks", title_justify="left")
    drawn.add_column("name", no_wrap=True)
    for heading in ("value", "reference", "ratio"):
        drawn.add_column(heading, justify="right", no_wrap=True)
    drawn.add_column("target")
    drawn.add_column("ok")
    for row in rows:
        unit, verdict = row["unit"], "[green]yes[/]" if row["ok"] else "[red]no[/]"
        numbers = _number(row["value"], unit), _number(row["reference"], unit), _number(row["ratio"], "x")
        drawn.add_row(row["name"], *numbers, row["target"], verdict)
    return drawn


def _number(number: Any, unit: str) -> str:
    return "" if number is None else f"{number:.4g} {unit}".strip()


def main(arguments: list[str]) -> int:
    """Measure, write after each part, print; the exit code is 0 also where a target was missed: the file says so."""
    parser = argparse.ArgumentParser(description="measure hapticd against its targets", allow_abbrev=False)
    parts_help = f"parts, of {', '.join(PARTS)} (default: $ONLY, else all)"
    parser.add_argument("--only", default=os.environ.get("ONLY", ""), help=parts_help)
    parser.add_argument("--output", type=Path, default=OUTPUT)
    asked = parser.parse_args(arguments)
    parts = chosen(asked.only)
    rows = load(asked.output) if asked.only else []
    measured: list[dict[str, Any]] = []
    for part in parts:
        console.print(f"{part} ...", end=" ")
        begin = time.monotonic()
        measured += [figure.plain() for figure in measure(part)]
        console.print(f"{time.monotonic() - begin:.0f} s")
        rows = merge(rows, measured)
        save(asked.output, rows)
    console.print(table(measured))
    for note in dict.fromkeys(row["note"] for row in measured if "note" in row):
        names = ", ".join(row["name"] for row in measured if row.get("note") == note)
        console.print(f"{names}: {note}", style="dim", highlight=False, markup=False)
    reached = sum(bool(row["ok"]) for row in measured)
    console.print(f"{reached} of {len(measured)} reached; written to {asked.output}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
