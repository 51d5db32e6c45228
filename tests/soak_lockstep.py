"""`make soak` in virtual time: hours of the whole stack in lock-step, in as many minutes or fewer.

    python tests/soak_lockstep.py --hours 2

The board has the random faults of `soak`; an operator sends random commands and enables the force
(`benchmarks.attack`). It counts leaks and losses. A leak is growth of the process's own memory, in
the half in which it grew less: a leak grows in both. Losses are ticks without a record, and
commands without an answer, each by its number. At the end no more commands are sent until all due
answers have arrived. The result goes to build/soak_lockstep.json after every ten virtual minutes.

Limitations: kept records (`keep=False` avoids them) make the memory grow by design.
"""

import argparse
import json
import os
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from random import Random
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from soak import BOARD_TIME_US, FAULTS, RATE_HZ, ROOT
from support.attacks.live import DTYPE
from support.boards import board_params
from support.models import servo_params

from benchmarks.attack import Operator
from hapticd.core.faults import BY_NUMBER
from hapticd.mailbox.client_side import Answer
from hapticd.mailbox.layout import State
from hapticd.model.params import InjectionParams
from hapticd.run.lockstep import LockStep

RESULT = ROOT / "build" / "soak_lockstep.json"
AT_ONCE = 100  # ticks between two looks of the operator
REPORT_TICKS = 600_000
TICKS_PER_HOUR = 3_600_000
ANSWERED_TICKS = 500  # in which every command is answered; a scheduled one says so at once


def anonymous_kb() -> int:
    """Return this process's own memory."""
    with open("/proc/self/smaps_rollup") as rollup:
        return sum(int(line.split()[1]) for line in rollup if line.startswith("Anonymous"))


class Tally:
    """The records and answers of a flight."""

    def __init__(self) -> None:
        self.ticks = self.enabled = self.commands = self.missing = 0
        self.due: dict[int, int] = {}  # when what has no answer yet was commanded, by its number
        self.faults: Counter[str] = Counter()
        self.memory_kb: list[int] = []
        self.state = 0
        self._next = 0

    def ask(self, posted: dict[int, int]) -> None:
        """Take over the commands since the last call."""
        self.commands += len(posted)
        self.due |= dict.fromkeys(posted, self.ticks)
        posted.clear()

    def add(self, block: bytes, given: Iterable[Answer]) -> None:
        """Take over records of some ticks, and the answers that arrived."""
        rows = np.frombuffer(block, DTYPE)
        self.missing += int((rows["tick"] != np.arange(len(rows)) + self._next).sum())
        self._next = int(rows["tick"][-1]) + 1
        self.ticks += len(rows)
        self.enabled += int((rows["state"] == State.ENABLED).sum())
        states = np.concatenate(([self.state], rows["state"]))
        for row in rows[(states[1:] == State.FAULT) & (states[:-1] != State.FAULT)]:
            self.faults[BY_NUMBER[int(row["fault"])].code] += 1
        self.state = int(states[-1])
        for answer in given:
            self.due.pop(answer.seq, None)  # a scheduled one has a second answer

    def figures(self) -> dict[str, Any]:
        """Return the present counts."""
        unanswered = [seq for seq, tick in self.due.items() if tick <= self.ticks - ANSWERED_TICKS]
        half = len(self.memory_kb) // 2
        grown = [
            part[-1] - part[0] for part in (self.memory_kb[:half], self.memory_kb[half:]) if part
        ]
        return {
            "hours": self.ticks / TICKS_PER_HOUR,
            "ticks": self.ticks,
            "ticks_enabled": self.enabled,
            "commands": self.commands,
            "faults_latched": dict(self.faults),
            "grown_kb": min(grown, default=0),
            "memory_kb": self.memory_kb,
            "unanswered": unanswered,
            "lost": {
                "ticks without a record": self.missing,
                "commands without an answer": len(unanswered),
            },
        }


def fly(hours: float, seed: int) -> dict[str, Any]:
    """Fly `hours` of virtual time."""
    injections = tuple(
        InjectionParams(
            one.kind,
            tick=-1,
            probability=one.per_s / RATE_HZ,
            count=one.count,
            value=one.value,
        )
        for one in FAULTS
    )
    board = board_params(
        injections=injections, watchdog_ms=20.0, board_time_us=BOARD_TIME_US, seed=seed
    )
    tally = Tally()
    with LockStep(servo_params(), board, keep=False) as stack:
        operator = Operator(stack, Random(seed))
        state = 0
        while tally.ticks < hours * TICKS_PER_HOUR - ANSWERED_TICKS:
            operator.act(state)
            tally.ask(operator.posted)
            tally.add(stack.run(AT_ONCE), stack.gateway.answers())
            state = tally.state
            if tally.ticks % (REPORT_TICKS // 10) < AT_ONCE:
                tally.memory_kb.append(anonymous_kb())
            if tally.ticks % REPORT_TICKS < AT_ONCE:
                write(tally.figures())
        tally.add(stack.run(ANSWERED_TICKS), stack.gateway.answers())
        return tally.figures()


def write(found: dict[str, Any]) -> None:
    """Write the file of results."""
    RESULT.parent.mkdir(exist_ok=True)
    RESULT.write_text(json.dumps(found, indent=1) + "\n")


def main() -> int:
    """Fly for the requested time."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--hours", type=float, default=float(os.environ.get("HOURS") or 2.0))
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    found = fly(asked.hours, asked.seed)
    write(found)
    print(json.dumps(found, indent=1))
    return 1 if any(found["lost"].values()) else 0


if __name__ == "__main__":
    raise SystemExit(main())
