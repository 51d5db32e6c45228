"""A daemon on virtual time, in this process: servo, wire, board, gateway command server and guard.

`VirtualBoard` answers as `hapticd run` does. The requests of a client go to the gateway's command
server. It checks limits and leases, has the guard judge them and returns receipts. Left out are
sockets, processes, the flight recording, and the topics `event` and `servo`. Its clock advances
only during run, streaming, recording or a wait. `aio()` returns the same board for asyncio; only
requests renew its leases.

    hapticd.virtual_board()            the simulated board of the shipped configuration
    hapticd.virtual_board(hand=True)   with a hand that holds the handle and moves it

The hand is a spring and a damper (500 N/m, 3 N s/m: a light grasp) to a point that wanders by 1 mm
rms, first order below 10 Hz, seeded (`model.touch`).

A thread must not send a request, since the clock belongs to the caller.
"""

import json
import time
from collections.abc import AsyncGenerator, Generator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgpack

from hapticd.client.client import Client
from hapticd.client.telemetry import accepted, receipt_of
from hapticd.core.errors import CommandError, ConfigError
from hapticd.core.params import GatewaySetup, from_plain, to_plain
from hapticd.core.units import NS_PER_S
from hapticd.gateway.command_server import CommandServer
from hapticd.gateway.publisher import state_map
from hapticd.guard.judge import Judge
from hapticd.guard.status import MOST_RECORDS, Guard
from hapticd.mailbox import files
from hapticd.model.params import BoardParams, GuardSetup, HandParams, TouchParams
from hapticd.protocol.answers import Receipt
from hapticd.protocol.codec import Encoding, encode
from hapticd.protocol.journal import Journal
from hapticd.protocol.view import ServoView
from hapticd.run.lockstep import LockStepClient
from hapticd.run.supervisor import resolve
from hapticd.settings.build import board_params
from hapticd.settings.load import load

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from hapticd.client.aio import AsyncClient
    from hapticd.client.client import ClientLease
    from hapticd.core.params import AtEnd, Leased

__all__ = ["VirtualBoard", "virtual_board"]

CLIENT = b"virtual"  # identity of the only connection
LOOK_TICKS = 20  # between two passes of the gateway while no work is due
HAND = HandParams("hold", stiffness_n_per_m=500.0, damping_ns_per_m=3.0, tremor_m=1e-3)


class _Judging:
    """The guard's worker in this process: its answer is available at once."""

    state = "up"
    trouble = ""
    life = 1

    def __init__(self, setup: GuardSetup) -> None:
        self._judge = Judge(setup)
        self.hello: dict[str, Any] = self._judge.hello(0)["hello"]
        self._said: list[dict[str, Any]] = []

    def tend(self, now_ns: int) -> None:
        """Do nothing."""

    def ask(self, request: dict[str, Any]) -> None:
        """Accept and answer a question."""
        self._said.append(self._judge.answer(request))

    def answers(self) -> list[dict[str, Any]]:
        """Return the answers to all questions since the last call."""
        found = self._said
        self._said = []
        return found

    def give_up(self, trouble: str) -> None:
        """Do nothing: answers are immediate."""

    def close(self) -> None:
        """Do nothing."""


class VirtualBoard(LockStepClient):
    """A Client whose daemon is in this process and whose clock is virtual; ready and disabled.

    `newest` is the record of the newest tick.
    """

    def __init__(self, setup: GatewaySetup, guard: GuardSetup, board: BoardParams) -> None:
        self._commands: CommandServer | None = None
        self._replies: list[list[bytes]] = []
        self._asked = 0  # number of requests, which identifies later answers
        super().__init__(setup.servo, board)
        self._journal = Journal(time.time_ns)
        self._view = ServoView(self._folder, setup.servo, time.time_ns)
        judged = Guard(self._view, self._journal, setup.guard, _Judging(guard))
        self._commands = CommandServer(
            self._view, self._journal, self._inquire, judged, setup.lease
        )
        self.run(MOST_RECORDS + LOOK_TICKS)  # until the guard knows the delay
        self.hello()

    def close(self) -> None:
        """End servo and board; may be called twice."""
        if self._commands is not None:
            self._commands = None
            self._view.drop()
            super().close()

    def aio(self) -> "AsyncClient":
        """Return a client for asyncio of the same board, which it closes; time advances while it
        waits.
        """
        from hapticd.client.aio import AsyncClient

        client = AsyncClient(name=self._name, folder=self._folder, strict=self._strict)
        client._connection._context.destroy()  # no socket is needed
        client._connection = _AsyncConnection(self)  # type: ignore[assignment]  # all that a client asks of it
        return client

    def _now_s(self) -> float:
        return self.stack.clock.now_ns() / NS_PER_S

    def run(self, ticks: int) -> bytes:
        """Run as `LockStep.run` does, with a pass of the gateway whenever it has work."""
        if self._commands is None:
            return super().run(ticks)
        data = []
        while ticks > 0:
            count = 1 if self._commands.waiting else min(ticks, LOOK_TICKS)
            data.append(super().run(count))
            ticks -= count
            now_ns = self.stack.clock.now_ns()
            self._view.refresh(now_ns)
            self._replies += self._commands.collect(now_ns)
        return b"".join(data)

    def call(self, cmd: str, **fields: Any) -> dict[str, Any]:
        """Send any command and return its whole reply. CommandError if gateway or servo refuses."""
        return accepted(self.exchange(cmd, self._as_asked(cmd, fields)))

    def exchange(self, cmd: str, fields: dict[str, Any]) -> dict[str, Any]:
        """Send a request and run until its reply arrives, accepted or not."""
        assert self._commands is not None
        given = {name: value for name, value in fields.items() if value is not None}
        self._asked += 1
        payload = encode(Encoding.MSGPACK, {"cmd": cmd, "id": self._asked, **given})
        self._replies = self._commands.serve([[CLIENT, payload]], self.stack.clock.now_ns())
        while not self._replies:
            self.run(1)
        reply: dict[str, Any] = msgpack.unpackb(self._replies[-1][-1])
        return reply

    def _inquire(self, cmd: str) -> dict[str, Any]:
        """Return the contents of hello and status, which the command server does not have."""
        if cmd == "dump":
            raise CommandError("refused", "dump: virtual time keeps no flight recording; record it")
        if cmd == "hello":
            servo = to_plain(self._servo)
            return {"rate_hz": self._servo.realtime.rate_hz, "simulated": True, "servo": servo}
        assert self._commands is not None
        return {
            **self._state(),
            "servo": self._view.report(),
            "guard": self._commands.guard_summary(),
            "events": list(self._journal.recent),
        }

    def _state(self) -> dict[str, Any]:
        assert self._commands is not None
        return state_map(self._view, self._commands.actors, self._commands.leases, time.time_ns())

    def _payloads(self, topic: str) -> Generator[bytes, None, None]:
        """Yield the topic `state` every second, or the topics of the bench."""
        while topic == "state":
            yield encode(Encoding.MSGPACK, self._state())
            self.sleep(1.0)
        yield from super()._payloads(topic)

    def stop(self) -> Receipt:
        """Stop and latch."""
        return receipt_of(self.call("stop"))

    def lease(
        self,
        what: "Leased",
        *,
        ttl_s: float | None = None,
        at_end: "AtEnd | None" = None,
        take_over: bool = False,
        keep_alive: bool = False,
    ) -> "ClientLease":
        """Acquire a lease as `Client.lease`. Time passes only in this thread, so there is no
        keep-alive.
        """
        return super().lease(what, ttl_s=ttl_s, at_end=at_end, take_over=take_over)

    def perturb_load(self, samples_n: "ArrayLike") -> int:
        """Load a waveform: force [N] at 4 kHz, shape (n,). Return its number of samples."""
        return Client.perturb_load(self, samples_n)


class _AsyncConnection:
    """Connection of an AsyncClient to a virtual board."""

    def __init__(self, board: VirtualBoard) -> None:
        self._board = board

    async def exchange(self, cmd: str, fields: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        return self._board.exchange(cmd, fields)

    async def pause(self, seconds: float) -> None:
        self._board.sleep(seconds)

    def now_s(self) -> float:
        return self._board._now_s()

    async def listen(self, topic: str, timeout_s: float) -> AsyncGenerator[bytes, None]:
        for payload in self._board._payloads(topic):
            yield payload

    async def close(self) -> None:
        """End the board."""
        self._board.close()


def virtual_board(
    config: Path | None = None, *, hand: bool = False, strict: bool = False, name: str = "script"
) -> VirtualBoard:
    """Return the simulated board of `config` (None: the shipped one) with servo and guard, on
    virtual time: a Client, ready and disabled.

    `hand`: whether a hand holds the handle and moves it. `name` and `strict` as for `Client`.
    ConfigError for the configuration of a real board.
    """
    settings = load(config)
    board = board_params(settings)
    if board is None:
        raise ConfigError(f"{settings.device_file} is a real board's; virtual time needs another")
    if hand:
        board = replace(board, touch=TouchParams(hands=(HAND,)))
    plain = json.loads(json.dumps(resolve(settings, files.DEFAULT_INSTANCE)))
    setup = from_plain(GatewaySetup, plain[files.GATEWAY_JSON])
    found = VirtualBoard(setup, from_plain(GuardSetup, plain[files.GUARD_JSON]), board)
    found._strict = strict
    found._name = name
    found.hello()
    return found
