"""The gateway's command server and the guard's judge in front of a servo in lock-step: no socket,
no process.

Requests, replies and events have their formats for clients; the judge answers at the next pass. All
is on the stack's virtual clock.

Limitations: a judge that takes longer than a tick (its time is not counted here).
"""

from collections.abc import Callable
from typing import Any

import msgpack

from benchmarks.guard_requests import Answering
from hapticd.core.errors import HapticdError
from hapticd.core.params import GuardParams
from hapticd.gateway.command_server import CommandServer
from hapticd.guard.status import Guard
from hapticd.protocol.codec import Encoding, encode
from hapticd.protocol.journal import Journal
from hapticd.protocol.view import ServoView, as_records
from hapticd.run.lockstep import LockStep

UNIX_NS = 1_800_000_000_000_000_000
CLIENT = b"client"
PATIENCE = 3000  # ticks until a reply arrives


class InProcess:
    """A connection to a judge in this process."""

    def __init__(self, judge: Answering) -> None:
        self._judge = judge
        self.hello: dict[str, Any] = {"pid": 0, "model": True, "model_hash": ""}
        self.trouble = ""
        self.state = "up"
        self.life = 1
        self.asked: list[dict[str, Any]] = []
        self.said: list[dict[str, Any]] = []
        self._ready: list[dict[str, Any]] = []

    def tend(self, now_ns: int) -> None:
        """Do nothing."""

    def ask(self, request: dict[str, Any]) -> None:
        """Answer at the next pass, like the worker."""
        try:
            answer = self._judge(request)
        except HapticdError as error:
            answer = {"n": request["n"], "error": f"{type(error).__name__}: {error}"}
        self.asked.append(request)
        self.said.append(answer)
        self._ready.append(answer)

    def answers(self) -> list[dict[str, Any]]:
        """Return its answers since the last call."""
        found = self._ready
        self._ready = []
        return found

    def give_up(self, trouble: str) -> None:
        """Fail: it does not hang."""
        raise AssertionError(trouble)

    def close(self) -> None:
        """Do nothing."""


class GuardedStack:
    """A client of the command server of a guarded servo."""

    def __init__(self, stack: LockStep, judge: Answering, policy: str) -> None:
        self.stack = stack
        self.line = InProcess(judge)
        self.journal = Journal(lambda: UNIX_NS)
        self.view = ServoView(stack.gateway.folder, stack.loop.params, lambda: UNIX_NS)
        self.guard = Guard(self.view, self.journal, GuardParams(policy=policy), self.line)
        self.server = CommandServer(self.view, self.journal, lambda cmd: {}, self.guard)
        self.events: list[dict[str, Any]] = []
        self.replies: dict[Any, dict[str, Any]] = {}
        self.watch: Callable[[], None] = lambda: None  # called after each tick
        self._number = 0
        self.run(3)

    def run(self, ticks: int = 1) -> None:
        """Run ticks of the servo, each followed by a pass of the gateway."""
        for _ in range(ticks):
            block = self.stack.run(1)
            now_ns = self.stack.clock.now_ns()
            self.view.refresh(now_ns)
            self.guard.count(as_records(block), self.view.life)
            self._take(self.server.collect(now_ns))
            self.events += self.journal.drain()
            self.watch()

    def send(self, **fields: Any) -> int:
        """Send a request and return its number."""
        self._number += 1
        request = encode(Encoding.MSGPACK, {"id": self._number, **fields})
        self._take(self.server.serve([[CLIENT, request]], self.stack.clock.now_ns()))
        return self._number

    def ask(self, **fields: Any) -> dict[str, Any]:
        """Send a request and run until its reply."""
        number = self.send(**fields)
        for _ in range(PATIENCE):
            if number in self.replies:
                return self.replies[number]
            self.run()
        raise AssertionError(f"no reply to {fields} within {PATIENCE} ticks")

    def ended(self, number: int) -> dict[str, Any] | None:
        """Return the event with the end of request `number`; None if there is none yet."""
        found = [one for one in self.events if one["kind"] == "answer" and one["id"] == number]
        return found[-1] if found else None

    def _take(self, replies: list[list[bytes]]) -> None:
        for *_, payload in replies:
            content = msgpack.unpackb(payload)
            self.replies[content["id"]] = content


class CommandServerClient:
    """The interface of a `guard_requests.Guarded` to the command server."""

    def __init__(self, guarded: GuardedStack) -> None:
        self.guarded = guarded
        self.asked: list[int] = []

    @property
    def tick(self) -> int:
        """Tick of the servo."""
        return self.guarded.view.tick

    def ask(self, change: dict[str, Any], at_tick: int = 0, enable: bool = False) -> None:
        """Send the request without waiting."""
        timed = {"at_tick": at_tick} if at_tick else {}
        if enable:
            self.asked.append(self.guarded.send(cmd="enable"))
        elif change:
            self.asked.append(self.guarded.send(cmd="set", **change, **timed))

    def disable(self) -> None:
        """Switch force off."""
        self.asked.append(self.guarded.send(cmd="disable"))

    def choose(self, mode: str) -> None:
        """Set another mode of the active damping."""
        self.asked.append(self.guarded.send(cmd="guard", mode=mode))

    def run(self, ticks: int) -> None:
        """Run ticks of the servo."""
        self.guarded.run(ticks)
