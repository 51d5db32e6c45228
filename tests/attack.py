"""`make attack`: run the rows of the attack suite, print them, and write build/attack.json.

    python tests/attack.py                          every row, whole
    python tests/attack.py --only commands,frames   some rows; they replace those of the file
    python tests/attack.py --factor 0.01            a hundredth of each

All cores run a row whose work can be divided, in parts with their own seeds. The exit code is 1 if
there was a loss, a stop took longer than STOP_MS, or a kind occurred too rarely.
"""

import argparse
import json
import os
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from support.attacks.rows import LEAST, Outcome, Row
from support.attacks.table import ROWS

ROOT = Path(__file__).resolve().parents[1]
RESULT = ROOT / "build" / "attack.json"
STOP_MS = 100.0  # within which the force has to be gone after a stop, whatever is going on


def parts(row: Row, times: int) -> Iterator[tuple[int, int]]:
    """(pieces, seed) of the parts of a run of `times`."""
    part = row.part or times
    for number, begin in enumerate(range(0, times, part)):
        yield min(part, times - begin), 1 + number * part


def run(row: Row, times: int) -> Outcome:
    """All parts of `row`."""
    shared = list(parts(row, times))
    if len(shared) == 1:
        return row.attack(*shared[0])
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        outcomes = pool.map(row.attack, *zip(*shared, strict=True))
        return sum(outcomes, Outcome(0))


def rarest(outcome: Outcome) -> dict[str, float]:
    """How often the rarest kind came, where the row counts kinds."""
    return {"rarest": float(min(outcome.came.values()))} if outcome.came else {}


def failed(outcome: Outcome, factor: float) -> bool:
    """Whether anything of a run of `factor` was lost, late, or not tried often enough."""
    slow = outcome.figures.get("stop_longest_ms", 0.0) > STOP_MS
    rare = rarest(outcome).get("rarest", LEAST) < int(min(1.0, factor) * LEAST)
    return outcome.lost > 0 or slow or rare


def told(row: Row, outcome: Outcome, seconds: float) -> dict[str, Any]:
    """The row of build/attack.json."""
    return {
        "name": row.name,
        "does": row.does,
        "expected": row.expected,
        "counter": row.counter,
        "tried": outcome.tried,
        "unit": row.unit,
        "lost": outcome.lost,
        "found": outcome.found,
        "figures": outcome.figures | rarest(outcome),
        "seconds": round(seconds),
        "command": f"make attack ONLY={row.name}",
    }


def merged(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return `rows` and the other rows of the file, in the order of the table."""
    kept = json.loads(RESULT.read_text()) if RESULT.exists() else []
    by_name = {one["name"]: one for one in [*kept, *rows]}
    return [by_name[row.name] for row in ROWS if row.name in by_name]


def main() -> int:
    """Run the selected rows."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--only", default=os.environ.get("ONLY", ""))
    parser.add_argument("--factor", type=float, default=float(os.environ.get("FACTOR") or 1.0))
    asked = parser.parse_args()
    names = asked.only.replace(",", " ").split() or [row.name for row in ROWS]
    unknown = set(names) - {row.name for row in ROWS}
    if unknown:
        parser.error(f"no row {', '.join(unknown)}; rows: {', '.join(one.name for one in ROWS)}")
    lost = False
    for row in (row for row in ROWS if row.name in names):
        begin = time.monotonic()
        outcome = run(row, max(1, round(asked.factor * row.times)))
        line = told(row, outcome, time.monotonic() - begin)
        print(json.dumps(line, indent=1), flush=True)
        rows = merged([line])
        RESULT.parent.mkdir(exist_ok=True)
        RESULT.write_text(json.dumps(rows, indent=1) + "\n")
        lost |= failed(outcome, asked.factor)
    return int(lost)


if __name__ == "__main__":
    raise SystemExit(main())
