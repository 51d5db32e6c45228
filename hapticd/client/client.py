"""The client: one connection to a running daemon; synchronous, never waiting for ever.

`GatewayConnection` holds the sockets: a DEALER for requests (`requests`), a PAIR that tells of new
connections, a SUB per subscription. Requests are given only to a gateway that is connected
(IMMEDIATE), so one that starts later finds no old commands in its queue; nothing lingers when it is
closed. `Client` carries out the exchanges of `commands`, as the client for asyncio does (`aio`);
telemetry is read by `telemetry`.

Every call ends within its time-out, with a reply, a CommandError (the daemon refused: `code` and
`detail` say why) or DaemonDown (nobody answers, or the gateway has no servo).

numpy is loaded by what needs it, streams and waveforms: a verb at the shell does not wait for it.

Requests of several threads take turns (a lease that is kept alive has one of its own); streams
belong to one thread. A wait for a reply must have a deadline: a gateway may die between request and
reply.
"""

import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import zmq

from hapticd.client.commands import Ask, Commands, Exchange, Pause, T, hand_event, loaded, reached
from hapticd.client.lease import ClientLease
from hapticd.client.requests import (
    STOP_TIMEOUT_S,
    RequestTracker,
    TimedOut,
    accepted,
    command_socket,
    pressed,
    quiet,
    receipt_of,
    silence,
    socket_file,
)
from hapticd.client.telemetry import Subscription, TelemetryReader
from hapticd.core.errors import CommandError, DaemonDown, HapticdError
from hapticd.core.units import NS_PER_S
from hapticd.mailbox.files import COMMAND_SOCKET, TELEMETRY_SOCKET
from hapticd.protocol.answers import Event, Get, GuardStatus, GuardVerdict, Hello, Receipt, Status

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from hapticd.client.sequence import AtRefusal, Step, StepReceipt
    from hapticd.core.params import AtEnd, Leased

__all__ = ["Client"]

SLICE_MS = 20  # between looks at whether another thread closes the connection


class GatewayConnection(Subscription):
    """Sockets to the gateway of a runtime folder; made when they are first needed."""

    def __init__(self, folder: Path, name: str) -> None:
        self._folder = folder
        self._name = name
        self._requests = RequestTracker()
        self._introduction: list[bytes] = []  # goes out before the next request
        super().__init__()
        # a lease that is kept alive is renewed by a thread of its own, over this connection
        self._turn = threading.Lock()
        self._closed = False  # a request that waits gives up
        self._socket: zmq.Socket[bytes] | None = None
        self._made: zmq.Socket[bytes]  # a message for each connection that was made

    def exchange(self, cmd: str, fields: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        """Send a request; its reply, accepted or not.

        DaemonDown: none in time; CommandError: too long.
        """
        if not self._turn.acquire(timeout=timeout_s):
            raise silence(TimedOut(cmd, timeout_s), self._folder)
        try:
            return self._exchange(cmd, fields, timeout_s)
        finally:
            self._turn.release()

    def close(self) -> None:
        """Close all sockets, for good; may be called twice, and by another thread than that of a
        request that waits. Telemetry is closed by the thread that reads it.
        """
        self._closed = True
        with self._turn:
            super().close()
            self._socket = None

    def _exchange(self, cmd: str, fields: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        self._require_open(cmd)
        socket = self._connected()
        timeout_ns = round(timeout_s * NS_PER_S)
        number, payload = self._requests.ask(cmd, fields, time.monotonic_ns(), timeout_ns)
        unsent = [payload]
        deadline = time.monotonic() + timeout_s
        while (outcome := self._requests.outcome(number, time.monotonic_ns())) is None:
            self._require_open(cmd)
            # a negative wait would be one for ever
            wait_ms = max(0, min(SLICE_MS, round(1000 * (deadline - time.monotonic()))))
            if unsent:
                # with IMMEDIATE it can be written to only when it is connected
                if socket.poll(wait_ms, zmq.POLLOUT):
                    self._meet()
                    due = self._introduction or unsent
                    with suppress(zmq.Again):  # the connection was lost meanwhile
                        socket.send(due[-1], zmq.NOBLOCK)
                        due.pop()
            elif socket.poll(wait_ms):
                self._requests.receive(socket.recv())
        if isinstance(outcome, TimedOut):
            raise silence(outcome, self._folder)
        return outcome

    def _require_open(self, cmd: str) -> None:
        if self._closed:
            raise DaemonDown(f"{cmd}: this client is closed")

    def _connected(self) -> "zmq.Socket[bytes]":
        """The command socket; made when it is first needed."""
        socket_file(self._folder, COMMAND_SOCKET)
        if self._socket is None:
            self._socket, self._made = command_socket(self._context, self._folder)
        return self._socket

    def _meet(self) -> None:
        """To a gateway each connection is another client; the gateway may be another one too."""
        while self._made.poll(0):
            self._made.recv_multipart()
            self._introduction = [self._requests.introduction(self._name)]

    def _endpoint(self) -> str:
        return f"ipc://{socket_file(self._folder, TELEMETRY_SOCKET)}"

    def _quiet(self, topic: str, timeout_s: float) -> HapticdError:
        return quiet(topic, self._folder, timeout_s)


class Client(TelemetryReader, Commands[Receipt, Hello, Get, Status, GuardStatus, dict[str, Any]]):
    """One connection to the daemon `instance`, best used as a context manager.

    `timeout_s` bounds every call; `name` is shown beside what this client changes; `folder` is the
    runtime folder where it is not that of the instance. A change that acts and is not safe emits a
    `GuardWarning`, once for each environment. With `strict` none acts: whatever the policy of the
    guard, what this client asks is judged as under `refuse`.

    Errors of every method: CommandError where the daemon refuses, DaemonDown where none answers in
    time. In the examples `device` is a `hapticd.virtual_board()`, disabled, whose active damping
    was switched on; `np` is numpy, `step` is `hapticd.client.step`.
    """

    _connection: GatewayConnection

    def _connect(self) -> None:
        self._connection = GatewayConnection(self._folder, self._name)

    # --- asking -----------------------------------------------------------------------------------

    def call(self, cmd: str, **fields: Any) -> dict[str, Any]:
        """Send any command; its whole reply {ok, id, rev, state, result or receipt}.

        CommandError where the daemon refuses, DaemonDown where none answers in time.

        >>> device.call("set", K=50)["receipt"]["effective"]["K"]
        50.0
        """
        asked = self._as_asked(cmd, fields)
        return accepted(self._connection.exchange(cmd, asked, self._timeout_s))

    def _carried_out(self, exchange: Exchange[T]) -> T:
        answer = None
        try:
            while True:
                answer = self._tried(exchange.send(answer))
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]  # what the generator returns

    def _tried(self, due: Ask | Pause) -> Any:
        """The reply to a request, or the error that it ended with; None after a pause."""
        try:
            if isinstance(due, Pause):
                return self._pause(due.seconds)
            return self.stop() if due.cmd == "stop" else self.call(due.cmd, **due.fields)
        except (CommandError, DaemonDown) as error:
            return error

    # --- changing ---------------------------------------------------------------------------------

    def hand(self, verdict: GuardVerdict, timeout_s: float = 1.0) -> Event | None:
        """The event that tells the hand which would shake what `verdict` is about.

        None if `timeout_s` passes first.

        >>> receipt = device.set(K=-100)
        >>> device.hand(receipt.guard).text
        '...'
        """
        return self._carried_out(hand_event(verdict, timeout_s))

    def _pause(self, seconds: float) -> None:
        """Let time pass; on virtual time no clock of this computer does."""
        time.sleep(seconds)

    def stop(self) -> Receipt:
        """Latched stop.

        Without a reply within 40 ms the stop word is pressed, which the servo reads.

        DaemonDown if there is no servo either.

        >>> device.stop().state
        'stopped'
        """
        try:
            return receipt_of(accepted(self._connection.exchange("stop", {}, STOP_TIMEOUT_S)))
        except (DaemonDown, CommandError):
            return pressed(self._folder)

    def lease(
        self,
        what: "Leased",
        *,
        ttl_s: float | None = None,
        at_end: "AtEnd | None" = None,
        take_over: bool = False,
        keep_alive: bool = False,
    ) -> ClientLease:
        """Be the only one who changes `what`, as a context: see ClientLease. With `keep_alive`, of
        the environment or the damping, a thread renews it: for a body that waits for a person.

        It ends when this client asks nothing for `ttl_s`, and at once when it dies; the environment
        then goes as `at_end` says, damping stays. `take_over`: end another's.

        >>> with device.lease("environment", ttl_s=5, at_end="disable") as lease:
        ...     receipt = device.set(K=100)
        ...     lease.sleep(10)
        """
        asked = {"ttl_s": ttl_s, "at_end": at_end, "take_over": take_over or None}
        return ClientLease(self.call, what, keep_alive, self._pause, **asked)

    def perturb_load(self, samples_n: "ArrayLike") -> int:
        """Load a waveform: force [N] at 4 kHz, shape (n,). The number of samples the daemon has.

        CommandError: a sample beyond the limits of the probe, or a waveform is playing.

        >>> one_second = 0.1 * np.sin(2 * np.pi * 5 * np.arange(4000) / 4000)
        >>> device.perturb_load(one_second)
        4000
        """
        return self._carried_out(loaded(samples_n))

    def sequence(
        self,
        steps: "Sequence[Step]",
        at_refusal: "AtRefusal" = "disable",
        lead_s: float | None = None,
    ) -> "tuple[StepReceipt, ...]":
        """Do `steps`, made by `step`, in their order and at their ticks; a receipt for each: see
        `hapticd.client.sequence`.

        CommandError: a step cannot be done, and nothing was sent. SequenceError: it ended before
        the last step, by a refusal or a lost daemon; force was then switched off, or stopped, or,
        with "hold", left as it was. A lost daemon is stopped by the stop word, but with "hold".
        `lead_s`: how long before its tick a step is sent; left out: half a second. It
        emits each `GuardWarning` at its end.

        >>> steps = [step("enable"), step("set", K=100, after_s=0.5), step("disable", after_s=1)]
        >>> [one.result for one in device.sequence(steps)]
        ['applied', 'applied', 'applied']
        """
        return self._carried_out(self._sequence(steps, at_refusal, lead_s))

    # --- watching ---------------------------------------------------------------------------------

    def wait_for(self, state: str, timeout_s: float = 10.0) -> None:
        """Return when the servo is in `state`.

        CommandError `timeout` or DaemonDown after `timeout_s`.

        >>> receipt = device.enable()
        >>> device.wait_for("enabled")
        """
        self._carried_out(reached(state, timeout_s))
