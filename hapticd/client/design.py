"""Conditions of an experiment: in which order they come, and a table that joins them to telemetry.

    conditions = sweep(K=(100, 200, 400), B=(1, 2))
    with Table(Path("session.csv"), answers=("response",)) as table, Client() as device:
        for block in blocks(conditions, 10, seed=1):
            for condition in block:
                table.begin(device.set(**condition.settings, ramp_s=0.2), condition)
                table.answer(response=input("stiffer? "))

Order (`blocks`, `pairs`) is random but balanced, and the same for the same seed: each block holds
each condition once; of pairs, half begin with A. What a person learns or tires then falls on all
conditions alike (Fisher 1935, The Design of Experiments).

A row of the table holds the revision and the ticks of the receipt, and what the guard said of the
condition: `guard_safe` (True, False; empty: unknown, or nobody judged it) and `guard_margin`, the
damping to spare [N s/m] in free space or in the wall, whichever is less. Both are of what was asked
for; what a policy made less of is in force as K, B, M and damping say. Every record of `servo.raw`
holds its revision, so `joined` gives each condition exactly the ticks in which it was in force,
ramps left out, whatever the clocks of both programs say.

Take the lease of the environment: a change by another client is a revision of its own, whose ticks
belong to no row.
"""

import csv
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self, TextIO

import numpy as np

from hapticd.client.blocks import Records
from hapticd.core.errors import CommandError, ConfigError
from hapticd.protocol.answers import Receipt

__all__ = ["Condition", "Table", "blocks", "joined", "pairs", "sweep"]

ENABLED = "enabled"  # the state of a receipt in which force acts
IN_FORCE = ("K", "B", "M", "active_damping")
TICKS = ("revision", "first_tick", "ramp_end_tick")
GUARD = ("guard_safe", "guard_margin")


class Condition(NamedTuple):
    """What is set for one presentation."""

    name: str
    settings: Mapping[str, Any]  # arguments of `set`


def sweep(**values: Sequence[float]) -> list[Condition]:
    """Every combination of the values of each argument of `set`, the last one changing fastest."""
    found = []
    for combination in itertools.product(*values.values()):
        settings = dict(zip(values, combination, strict=True))
        name = ", ".join(f"{key} {value:g}" for key, value in settings.items())
        found.append(Condition(name, settings))
    return found


def blocks(conditions: Sequence[Condition], count: int, seed: int) -> list[tuple[Condition, ...]]:
    """`count` blocks, each with every one of `conditions` once, in an order of its own."""
    random = np.random.default_rng(seed)
    orders = [random.permutation(len(conditions)) for _ in range(count)]
    return [tuple(conditions[place] for place in order) for order in orders]


def pairs(a: Condition, b: Condition, count: int, seed: int) -> list[tuple[Condition, Condition]]:
    """`count` pairs of A and B in random order, half of them A first. ConfigError for an odd
    `count`, of which no half exists.
    """
    if count % 2:
        raise ConfigError(
            f"{count} pairs cannot start with A and with B equally often; choose an even"
        )
    first = np.repeat([True, False], count // 2)
    np.random.default_rng(seed).shuffle(first)
    return [(a, b) if a_first else (b, a) for a_first in first]


class Table:
    """A CSV file at `path` with one row for each condition that was presented; `answers` are the
    columns that the experiment adds.

    A row is on the disk before the next condition begins. ConfigError where `path` exists already.
    """

    def __init__(self, path: Path, answers: Sequence[str] = ()) -> None:
        if path.exists():
            raise ConfigError(f"{path} already exists; use a new file for each session")
        self._path = path
        self._answers = tuple(answers)
        self._row: dict[str, Any] = {}
        self._number = 0
        self._file: TextIO | None = None

    def __enter__(self) -> Self:
        self._file = self._path.open("w", newline="", encoding="utf-8")
        fields = ("number", "condition", *TICKS, *IN_FORCE, *GUARD, *self._answers)
        self._writer = csv.DictWriter(self._file, fields)
        self._writer.writeheader()
        return self

    def __exit__(self, *_: object) -> None:
        self._flush()
        if self._file is not None:
            self._file.close()

    def begin(self, receipt: Receipt, condition: Condition) -> None:
        """Present `condition` from the tick of `receipt` on. CommandError: the servo makes
        no force, so it cannot be felt.
        """
        self._flush()
        if receipt.state != ENABLED:
            text = f"condition {condition.name!r}: the servo is {receipt.state}, so it is not felt"
            raise CommandError("refused", f"{text}; end the session, or enable and present it anew")
        self._number += 1
        ticks = {name: getattr(receipt, name) for name in TICKS}
        in_force = {name: receipt.effective.get(name) for name in IN_FORCE}
        named = {"number": self._number, "condition": condition.name}
        self._row = named | ticks | in_force | _guarded(receipt)

    def answer(self, **answers: Any) -> None:
        """What came of the presentation that has begun. ConfigError for a column that the table
        was not given.
        """
        if unknown := set(answers) - set(self._answers):
            known = ", ".join(self._answers) or "none"
            raise ConfigError(
                f"{', '.join(sorted(unknown))}: no such column; the table has {known}"
            )
        self._row.update(answers)

    def _flush(self) -> None:
        if self._row and self._file is not None:
            self._writer.writerow(self._row)
            self._file.flush()
        self._row = {}


def _guarded(receipt: Receipt) -> dict[str, Any]:
    """What the guard said of the condition, by the names of its columns."""
    verdict = receipt.guard
    said = (verdict.safe, verdict.worse.margin_ns_per_m) if verdict else (None, None)
    return dict(zip(GUARD, said, strict=True))


def joined(path: Path, records: Records) -> Iterator[tuple[dict[str, str], Records]]:
    """Each row of the table at `path` with the records (n,) of `servo.raw` in which its condition
    was in force, from the end of its ramps on.
    """
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            there = records["revision"] == int(row["revision"])
            settled = records["tick"] >= int(row["ramp_end_tick"])
            yield row, records[there & settled]
