"""The real guard with its judge in front of the real servo, on virtual time. At every tick of a
change in stages the board reports the damping that the environment in force needs.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from hapticd.core.arrays import Records
from hapticd.core.params import GuardParams, from_plain
from hapticd.gateway.command_server import CommandServer
from hapticd.guard.judge import Judge
from hapticd.guard.status import MOST_RECORDS, Guard
from hapticd.mailbox import files
from hapticd.model.params import GuardSetup, InjectionParams
from hapticd.protocol.journal import Journal
from hapticd.protocol.view import ServoView, as_records
from hapticd.run.lockstep import LockStep
from hapticd.run.supervisor import resolve
from hapticd.settings.build import board_params, servo_params
from hapticd.settings.load import load
from support.gateway_rig import UNIX_NS, decoded, packed
from support.guard_stub import StubWorker

LEVEL_NS_PER_M = 1.74
STIFF = {"K": 500.0, "B": 2.0}  # passive with that damping, not without


class Flight:
    """A servo, its simulated board, and the gateway's command server with a judge behind it."""

    def __init__(self, *injections: InjectionParams) -> None:
        settings = load(None)
        setup = resolve(settings, "flight")[files.GUARD_JSON]
        self.judge = Judge(from_plain(GuardSetup, json.loads(json.dumps(setup))))
        params = servo_params(settings, "flight")
        board = board_params(settings)
        assert board is not None
        self.stack = LockStep(params, replace(board, injections=injections))
        self.worker = StubWorker(self.judge.answer)
        self.params = params
        self.another_gateway()
        self.replies: list[dict[str, Any]] = []
        self.fly(MOST_RECORDS + 20)  # before that a strict policy refuses every change

    def another_gateway(self) -> None:
        """Replace the command server by one without state."""
        self.view = ServoView(Path(self.stack.mailbox.folder), self.params, lambda: UNIX_NS)
        self.journal = Journal(lambda: UNIX_NS)
        self.guard = Guard(self.view, self.journal, GuardParams(), self.worker)
        self.server = CommandServer(self.view, self.journal, lambda cmd: {}, self.guard)

    def fly(self, ticks: int) -> Records:
        """Ticks, each with a pass of the gateway; their records."""
        flown = []
        for _ in range(ticks):
            flown.append(self.stack.run(1))
            now_ns = self.stack.clock.now_ns()
            self.view.refresh(now_ns)
            self.replies += [decoded(reply) for reply in self.server.collect(now_ns)]
        return as_records(b"".join(flown))

    def ask(self, **fields: Any) -> dict[str, Any]:
        """One request and its reply."""
        found = self.server.serve([[b"a", packed(**fields)]], self.stack.clock.now_ns())
        self.replies = [decoded(reply) for reply in found]
        while not self.replies:
            self.fly(1)
        (reply,) = self.replies
        return reply

    def ends(self) -> list[str]:
        """Return how changes in stages ended since the last call."""
        return [one["result"] for one in self.journal.drain() if one["kind"] == "answer"]


class ServerConnection:
    """The line of a `Client` to the command server of `flight`, without sockets."""

    def __init__(self, flight: Flight) -> None:
        self._flight = flight

    def exchange(self, cmd: str, fields: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        given = {name: value for name, value in fields.items() if value is not None}
        return self._flight.ask(cmd=cmd, **given)

    def close(self) -> None:
        """Do nothing."""


class AsyncServerConnection:
    """The same for an `AsyncClient`."""

    def __init__(self, flight: Flight) -> None:
        self._line = ServerConnection(flight)

    async def exchange(self, cmd: str, fields: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        return self._line.exchange(cmd, fields, timeout_s)

    async def close(self) -> None:
        """Do nothing."""


def rendering(flight: Flight, policy: str) -> None:
    """Force on, a stiff environment, and the damping that it needs."""
    assert flight.ask(cmd="guard", policy=policy)["ok"]
    assert flight.ask(cmd="damping", value=LEVEL_NS_PER_M)["ok"]
    flight.fly(300)
    assert flight.ask(cmd="enable")["ok"]
    flight.fly(600)
    assert flight.ask(cmd="set", **STIFF)["receipt"]["result"] == "applied"
    flight.fly(200)
