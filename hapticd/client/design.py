"""Experiments: the order of conditions, a table that joins them to telemetry, and a staircase.

    conditions = sweep(K=(100, 200, 400), B=(1, 2))
    with Table(Path("session.csv"), answers=("response",)) as table, Client() as device:
        for block in blocks(conditions, 10, seed=1):
            for condition in block:
                table.begin(device.set(**condition.settings, ramp_s=0.2), condition)
                table.answer(response=input("stiffer? "))

Order (`blocks`, `pairs`). It is random but balanced, and the same for the same seed. Each block
contains each condition once; half of the pairs begin with A. Learning and fatigue then affect all
conditions alike (Fisher 1935, The Design of Experiments).

Table (`Table`, `joined`). A row contains the revision and the ticks of the receipt, and the guard's
verdict. `guard_safe` is True, False or empty (unknown or not judged). `guard_margin` is the margin
of damping [N s/m] in free space or in the wall, whichever is smaller. Both refer to the request. If
a policy reduced it, K, B, M and damping show the values in force. Every record of `servo.raw`
contains its revision. So `joined` returns for each condition exactly the ticks in which it was in
force, without ramps. The clocks of both programs do not matter.

Take the lease of the environment: a change by another client is another revision, whose ticks
belong to no row.

Staircase (`Staircase`). It finds the level at which a person answers correctly in a known share of
trials:

    staircase = Staircase(0.5)
    while not staircase.finished:
        staircase.answer(presented_and_answered_rightly(staircase.level))
    print(staircase.threshold)

Transformed up-down method (Levitt 1971, J. Acoust. Soc. Am. 49:467): `down` right answers in a row
lower the level, each wrong answer raises it. It converges to the level at which both are equally
likely. There the share of right answers p has p^down = 1/2: 0.707 for two, 0.794 for three. Steps
are factors, so the threshold is the geometric mean of the levels at which the direction reversed.
The first reversals depend on the initial level and are left out.

Levels must be positive, since a step multiplies them.
"""

import csv
import itertools
from collections.abc import Iterator, Mapping, Sequence
from math import exp, inf, isfinite, log
from pathlib import Path
from typing import Any, NamedTuple, Self, TextIO

import numpy as np

from hapticd.core.arrays import Records
from hapticd.core.errors import CommandError, ConfigError
from hapticd.protocol.answers import Receipt

__all__ = ["Condition", "Staircase", "Table", "blocks", "joined", "pairs", "sweep"]

ENABLED = "enabled"  # the state of a receipt in which force acts
IN_FORCE = ("K", "B", "M", "active_damping")
TICKS = ("revision", "first_tick", "ramp_end_tick")
GUARD = ("guard_safe", "guard_margin")


class Condition(NamedTuple):
    """Settings of one presentation."""

    name: str
    settings: Mapping[str, Any]  # arguments of `set`


def sweep(**values: Sequence[float]) -> list[Condition]:
    """Return every combination of the values of each argument of `set`, the last one changing
    fastest.
    """
    found = []
    for combination in itertools.product(*values.values()):
        settings = dict(zip(values, combination, strict=True))
        name = ", ".join(f"{key} {value:g}" for key, value in settings.items())
        found.append(Condition(name, settings))
    return found


def blocks(conditions: Sequence[Condition], count: int, seed: int) -> list[tuple[Condition, ...]]:
    """Return `count` blocks, each with all `conditions` once, in random order."""
    random = np.random.default_rng(seed)
    orders = [random.permutation(len(conditions)) for _ in range(count)]
    return [tuple(conditions[place] for place in order) for order in orders]


def pairs(a: Condition, b: Condition, count: int, seed: int) -> list[tuple[Condition, Condition]]:
    """Return `count` pairs of A and B in random order, half of them A first. ConfigError for an odd
    `count`.
    """
    if count % 2:
        raise ConfigError(
            f"{count} pairs cannot start with A and with B equally often; choose an even"
        )
    first = np.repeat([True, False], count // 2)
    np.random.default_rng(seed).shuffle(first)
    return [(a, b) if a_first else (b, a) for a_first in first]


class Table:
    """A CSV file at `path` with one row for each presented condition; `answers` are the columns
    added by the experiment.

    A row is on the disk before the next condition begins. ConfigError if `path` exists already.
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
        """Present `condition` from the tick of `receipt` on. CommandError if the servo makes no
        force, so that it cannot be felt.
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
        """Record the answers to the current presentation. ConfigError for an unknown column."""
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
    """Return the guard's verdict on the condition, by the names of its columns."""
    verdict = receipt.guard
    said = (verdict.safe, verdict.worse.margin_ns_per_m) if verdict else (None, None)
    return dict(zip(GUARD, said, strict=True))


def joined(path: Path, records: Records) -> Iterator[tuple[dict[str, str], Records]]:
    """Yield each row of the table at `path` with the records (n,) of `servo.raw` in which its
    condition was in force, from the end of its ramps on.
    """
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            there = records["revision"] == int(row["revision"])
            settled = records["tick"] >= int(row["ramp_end_tick"])
            yield row, records[there & settled]


# --- the staircase --------------------------------------------------------------------------------
DISCARDED = 2  # reversals that depend on the first level


class Staircase:
    """A staircase that begins at `level`, in any unit, and ends after `reversals` reversals.

    `down` right answers in a row divide the level by `factor`, a wrong one multiplies it, within
    `lowest` to `highest`. ConfigError for invalid numbers.
    """

    def __init__(
        self,
        level: float,
        *,
        down: int = 2,
        factor: float = 1.25,
        reversals: int = 8,
        lowest: float = 0.0,
        highest: float = inf,
    ) -> None:
        if not (isfinite(level) and level > 0.0 and lowest <= level <= highest):
            limits = f"positive, in {lowest:g}..{highest:g}"
            raise ConfigError(f"level = {level:g}: a staircase begins at a level that is {limits}")
        if not factor > 1.0 or down < 1 or reversals <= DISCARDED:
            asked = f"factor = {factor:g}, down = {down}, reversals = {reversals}"
            needed = f"factor > 1, down >= 1, reversals > {DISCARDED}"
            raise ConfigError(f"{asked}: a staircase needs {needed}")
        self.level = level
        self.turns: list[float] = []  # levels at which the direction reversed
        self._down = down
        self._factor = factor
        self._reversals = reversals
        self._limits = (lowest, highest)
        self._right = 0  # answers in a row
        self._falling = True

    @property
    def finished(self) -> bool:
        """Whether it has reversed often enough."""
        return len(self.turns) >= self._reversals

    @property
    def threshold(self) -> float:
        """The geometric mean of the reversals, in the unit of the level.

        ConfigError until it is finished.
        """
        if not self.finished:
            progress = f"{len(self.turns)} of {self._reversals} turns"
            raise ConfigError(f"the staircase has {progress}; answer until it is finished")
        counted = self.turns[DISCARDED:]
        return exp(sum(map(log, counted)) / len(counted))

    def answer(self, right: bool) -> None:
        """Record the answer to the presentation at `level`, and move the level."""
        self._right = self._right + 1 if right else 0
        if self._right not in (0, self._down):
            return
        falls = self._right == self._down
        self._right = 0
        if falls != self._falling:
            self.turns.append(self.level)
        self._falling = falls
        lowest, highest = self._limits
        moved = self.level / self._factor if falls else self.level * self._factor
        self.level = min(highest, max(lowest, moved))
