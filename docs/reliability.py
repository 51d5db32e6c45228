"""Write the tables of docs/development/reliability.md from the results of `make attack` and
`make soak`: `python docs/reliability.py`.

They come from build/attack.json, build/soak.json and build/soak_lockstep.json, as far as these
exist. The text is written by hand.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pages.markdown import replaced

DOCS = Path(__file__).parent
PAGE = DOCS / "development" / "reliability.md"
BUILD = DOCS.parent / "build"
UNITS = {"ms": "ms", "kb": "kB", "percent": "%", "s": "s"}
PLAIN = {"true_mounts": "", "true_user": "", "fifo": ""}  # described in the text


def attacks(rows: list[dict[str, Any]]) -> str:
    """Return one line for each attack."""
    lines = ["| attack | has to come of it | would show a loss | tried | lost | figures |"]
    lines.append("|---|---|---|---|---|---|")
    for row in rows:
        tried = f"{row['tried']:,} {row['unit']}"
        what = f"{row['does']}: `{row['command']}`"
        cells = (what, row["expected"], row["counter"], tried, row["lost"], _figures(row))
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def _figures(row: dict[str, Any]) -> str:
    told = {name: value for name, value in row["figures"].items() if name not in PLAIN}
    return ", ".join(f"{_words(name)} {_number(name, value)}" for name, value in told.items())


def _words(name: str) -> str:
    words = name.split("_")
    return " ".join(words[:-1] if words[-1] in UNITS and len(words) > 1 else words)


def _number(name: str, value: float) -> str:
    unit = UNITS.get(name.rpartition("_")[2], "") if "_" in name else ""
    digits = f"{value:,.0f}" if value >= 1000 else f"{value:.3g}"
    return f"{digits} {unit}".strip()


def soaked(found: dict[str, Any]) -> str:
    """Return the achievements and losses of the soak."""
    counters = found["counters"]
    rows = [
        ("ran for", f"{found['seconds'] / 60:.0f} min"),
        ("ticks; with force on", f"{found['ticks']:,}; {found['ticks_enabled']:,}"),
        ("commands; refused, with a reason", _commands(found)),
        ("subscribers that came and went", f"{found['subscribers']:,}"),
        ("times the board was plugged in again", counters["reconnects"]),
        ("restarts of its firmware", counters["board_lives"]),
        ("frames missing; damaged; stale or late", _frames(counters)),
        ("faults latched, and reset", _counts(found["faults_latched"])),
        ("stops pressed; longest until no force", _stops(found)),
        ("late ticks; of", f"{found['late_ticks']}; {found['late_of']:,}"),
        ("late wakes of cyclictest; of", _beside(found)),
        ("p that ticks are late no more often (Fisher)", f"{found.get('fisher_p', 0.0):.2g}"),
        ("private memory, last quarter minus the one before", _grown(found["grown_kb"])),
        *((f"lost: {name}", count) for name, count in found["lost"].items()),
    ]
    return _table(rows)


def flown(found: dict[str, Any]) -> str:
    """Return the achievements and losses of the soak in virtual time."""
    rows = [
        ("virtual time", f"{found['hours']:.2f} h"),
        ("ticks; with force on", f"{found['ticks']:,}; {found['ticks_enabled']:,}"),
        ("commands", f"{found['commands']:,}"),
        ("faults latched, and reset", _counts(found["faults_latched"])),
        ("own memory, in the half in which it grew less", f"{found['grown_kb']:+,} kB"),
        *((f"lost: {name}", count) for name, count in found["lost"].items()),
    ]
    return _table(rows)


def _table(rows: list[tuple[str, Any]]) -> str:
    lines = ["| | |", "|---|---|"]
    return "\n".join([*lines, *(f"| {name} | {value} |" for name, value in rows)])


def _commands(found: dict[str, Any]) -> str:
    return f"{found['commands']:,}; {sum(found['commands_refused'].values()):,}"


def _frames(counters: dict[str, int]) -> str:
    late = counters["stale_in"] + counters["behind_in"]
    return f"{counters['missing_in']:,}; {counters['bad_in']:,}; {late:,}"


def _stops(found: dict[str, Any]) -> str:
    return ", ".join(
        f"{kind} {one['count']}; {one['longest_ms']:.0f} ms" for kind, one in found["stops"].items()
    )


def _beside(found: dict[str, Any]) -> str:
    return f"{found.get('cyclictest_late', '-')}; {found.get('cyclictest_of', 0):,}"


def _counts(found: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in sorted(found.items()) if count) or "none"


def _grown(found: dict[str, float]) -> str:
    return ", ".join(f"{name} {kb:+,.0f} kB" for name, kb in found.items())


TABLES: dict[str, Callable[[Any], str]] = {
    "attack": attacks,
    "soak": soaked,
    "soak_lockstep": flown,
}


def filled(page: str) -> str:
    """Return `page` with the tables of all existing results."""
    for name, table in TABLES.items():
        source = BUILD / f"{name}.json"
        if source.exists():
            page = replaced(page, name, table(json.loads(source.read_text())))
    return page


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text()))
