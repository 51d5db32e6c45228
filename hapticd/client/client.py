"""The synchronous client: one connection to a running daemon, and its leases.

Connection (`GatewayConnection`). It holds the sockets: a DEALER for requests (`requests`), a PAIR
that reports new connections, a SUB per subscription. Requests are sent only to a connected gateway
(IMMEDIATE), so one that starts later finds no old commands in its queue; no message lingers after
closing. `Client` carries out the exchanges of `commands`, like the client for asyncio (`aio`);
`telemetry` reads the telemetry.

Calls (`Client`). Every call ends within its time-out with a reply or an error. CommandError: the
daemon refused; `code` and `detail` give the reason. DaemonDown: no answer, or the gateway has no
servo.

numpy is loaded only by streams and waveforms: a verb at the shell does not wait for it.

Requests of several threads take turns (a lease with keep-alive has its own thread); streams belong
to one thread. A wait for a reply must have a deadline: a gateway may die between request and reply.

Lease (`ClientLease`). Its holder has exclusive control of a part of the display:

    with client.lease("environment", ttl_s=5) as lease:
        client.set(K=100)
        lease.sleep(60)
        client.set(K=200)

Every request renews it; `renew` and `sleep` cover periods without requests. A client that hangs
loses its lease after `ttl_s`, one that dies at once.

With `keep_alive=True` a thread also renews it, over the same connection, so that the body may wait
for a person. Such a lease ends only with its process or its connection: a deadlocked main thread
keeps it. It is intended for the environment and the damping, never for a program that moves the
handle by itself.

Limitations: without `keep_alive`, `time.sleep` for longer than `ttl_s` loses the lease.

An exception that ends the context, such as Ctrl-C, triggers the action `at_end` at once.
"""

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import zmq

from hapticd.client.commands import Ask, Commands, Exchange, Pause, T, hand_event, loaded, reached
from hapticd.client.telemetry import (
    STOP_TIMEOUT_S,
    RequestTracker,
    Subscription,
    TelemetryReader,
    TimedOut,
    accepted,
    command_socket,
    pressed,
    quiet,
    receipt_of,
    silence,
    socket_file,
)
from hapticd.core.errors import CommandError, DaemonDown, HapticdError
from hapticd.core.units import NS_PER_S
from hapticd.mailbox.files import COMMAND_SOCKET, TELEMETRY_SOCKET
from hapticd.protocol.answers import (
    Coupling,
    Event,
    Get,
    GuardStatus,
    GuardVerdict,
    Hello,
    LeaseHeld,
    LeaseReleased,
    Receipt,
    Status,
    answer_of,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from hapticd.client.sequence import AtRefusal, Step, StepReceipt
    from hapticd.core.params import AtEnd, Leased

__all__ = ["Client", "ClientLease"]

# --- leases ---------------------------------------------------------------------------------------
RENEWALS = 3  # within the time after which it would end
KEPT_ALIVE = ("environment", "active_damping")


def lost_error(text: str) -> CommandError:
    """Return the error for a lost lease; `text` gives the cause."""
    return CommandError("leased", f"{text}; changes since then were not excluded")


def renews_again(error: HapticdError) -> bool:
    """Return whether another renewal may succeed: no answer in time, or no room."""
    code = error.code if isinstance(error, CommandError) else ""
    return isinstance(error, DaemonDown) or code in ("timeout", "busy")


class ClientLease:
    """A lease of `what`, taken at the begin of the context and released at its end.

    `call` is Client.call; `pause` waits for seconds; `asked` are the other fields of the command. A
    lost lease raises a CommandError: at the next change of the leased part, in `renew` and `sleep`,
    and at the end of the context.
    """

    def __init__(
        self,
        call: Callable[..., dict[str, Any]],
        what: str,
        keep_alive: bool = False,
        pause: Callable[[float], None] = time.sleep,
        **asked: Any,
    ) -> None:
        if keep_alive and what not in KEPT_ALIVE:
            names = " and ".join(KEPT_ALIVE)
            text = f"lease of {what}: keep_alive is for {names}; renew it while you work"
            raise CommandError("invalid", text)
        self._call = call
        self._pause = pause
        self._keep_alive = keep_alive
        self._left = threading.Event()  # the context has ended, or the lease is lost
        self._keeper: threading.Thread | None = None
        self._what = what
        self._asked = asked
        self._ttl_s = 0.0
        self._released = False  # by the body of the context

    def __enter__(self) -> Self:
        self.take()
        if self._keep_alive:
            self._left.clear()
            self._keeper = threading.Thread(target=self._keep, name="hapticd-lease", daemon=True)
            self._keeper.start()
        return self

    def _keep(self) -> None:
        """Renew until the context ends. The holder's next change reports a lost lease."""
        while not self._left.wait(self._ttl_s / RENEWALS):
            try:
                self.renew()
            except HapticdError as error:
                if not renews_again(error):
                    return

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._left.set()
        if self._keeper is not None:
            self._keeper.join()
        if self._released:
            return
        try:
            lost = self.release(failed=kind is not None)
        except Exception:
            if kind is None:
                raise
            return  # the exception in the context has precedence
        if lost and kind is None:
            raise lost_error(lost)

    def take(self) -> LeaseHeld:
        """Take the lease. CommandError if another client holds it."""
        held = answer_of(LeaseHeld, self._call("lease", what=self._what, **self._asked)["result"])
        self._ttl_s = held.ttl_s
        self._released = False
        return held

    def renew(self) -> None:
        """Keep the lease for another `ttl_s`. CommandError if it is lost."""
        self._call("lease", what=self._what, action="renew")

    def sleep(self, seconds: float) -> None:
        """Wait at least `seconds`, and keep the lease. CommandError as soon as it is lost."""
        self.renew()
        while seconds > 0.0:
            slice_s = min(seconds, self._ttl_s / RENEWALS)
            self._pause(slice_s)
            seconds -= slice_s
            self.renew()

    def release(self, failed: bool = False) -> str:
        """Release the lease; return the cause if it was lost before, otherwise "". `failed`: also
        perform `at_end`. CommandError if there is no such lease.
        """
        reply = self._call("lease", what=self._what, action="fail" if failed else "release")
        ended = answer_of(LeaseReleased, reply["result"])
        self._released = True
        return "" if ended.released else ended.text


# --- the client -----------------------------------------------------------------------------------
SLICE_MS = 20  # between checks whether another thread closes the connection


class GatewayConnection(Subscription):
    """Sockets to the gateway of a runtime folder, created on first use."""

    def __init__(self, folder: Path, name: str) -> None:
        self._folder = folder
        self._name = name
        self._requests = RequestTracker()
        self._introduction: list[bytes] = []  # sent before the next request
        super().__init__()
        # a lease with keep-alive is renewed by its own thread, over this connection
        self._turn = threading.Lock()
        self._closed = False  # a waiting request gives up
        self._socket: zmq.Socket[bytes] | None = None
        self._made: zmq.Socket[bytes]  # a message for each new connection

    def exchange(self, cmd: str, fields: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        """Send a request and return its reply, accepted or not.

        DaemonDown without a reply in time; CommandError if the request is too long.
        """
        if not self._turn.acquire(timeout=timeout_s):
            raise silence(TimedOut(cmd, timeout_s), self._folder)
        try:
            return self._exchange(cmd, fields, timeout_s)
        finally:
            self._turn.release()

    def close(self) -> None:
        """Close all sockets permanently. It may be called twice, and by another thread than that of
        a waiting request. The thread that reads telemetry closes its sockets.
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
            # a negative wait would be endless
            wait_ms = max(0, min(SLICE_MS, round(1000 * (deadline - time.monotonic()))))
            if unsent:
                # with IMMEDIATE it is writable only when connected
                if socket.poll(wait_ms, zmq.POLLOUT):
                    self._meet()
                    due = self._introduction or unsent
                    with suppress(zmq.Again):  # the connection was lost
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
        """Return the command socket, created on first use."""
        socket_file(self._folder, COMMAND_SOCKET)
        if self._socket is None:
            self._socket, self._made = command_socket(self._context, self._folder)
        return self._socket

    def _meet(self) -> None:
        """Introduce each new connection: it is a new client to the gateway, which may also be a new
        one.
        """
        while self._made.poll(0):
            self._made.recv_multipart()
            self._introduction = [self._requests.introduction(self._name)]

    def _endpoint(self) -> str:
        return f"ipc://{socket_file(self._folder, TELEMETRY_SOCKET)}"

    def _quiet(self, topic: str, timeout_s: float) -> HapticdError:
        return quiet(topic, self._folder, timeout_s)


class Client(
    TelemetryReader,
    Commands[Receipt, Hello, Get, Status, GuardStatus, dict[str, Any], Coupling],
):
    """One connection to the daemon `instance`, best used as a context manager.

    `timeout_s` bounds every call; `name` identifies this client in logs and status; `folder` is the
    runtime folder if it is not that of the instance. An unsafe change that acts emits a
    `GuardWarning`, once for each environment. With `strict` no unsafe change acts: the requests of
    this client are judged as under `refuse`, for any policy of the guard.

    Errors of every method: CommandError if the daemon refuses, DaemonDown without an answer in
    time. In the examples `device` is a `hapticd.virtual_board()`, disabled, with its active damping
    switched on; `np` is numpy, `step` is `hapticd.client.step`.
    """

    _connection: GatewayConnection

    def _connect(self) -> None:
        self._connection = GatewayConnection(self._folder, self._name)

    # --- asking -----------------------------------------------------------------------------------

    def call(self, cmd: str, **fields: Any) -> dict[str, Any]:
        """Send any command and return its whole reply {ok, id, rev, state, result or receipt}.

        CommandError if the daemon refuses, DaemonDown without an answer in time.

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
        """Return the reply to a request, or its error; None after a pause."""
        try:
            if isinstance(due, Pause):
                return self._pause(due.seconds)
            return self.stop() if due.cmd == "stop" else self.call(due.cmd, **due.fields)
        except (CommandError, DaemonDown) as error:
            return error

    # --- changing ---------------------------------------------------------------------------------

    def hand(self, verdict: GuardVerdict, timeout_s: float = 1.0) -> Event | None:
        """Return the event that describes the hand for which the change of `verdict` is unstable.

        None if `timeout_s` passes first.

        >>> receipt = device.set(K=-100)
        >>> device.hand(receipt.guard).text
        '...'
        """
        return self._carried_out(hand_event(verdict, timeout_s))

    def _pause(self, seconds: float) -> None:
        """Sleep for `seconds`; on virtual time no real time passes."""
        time.sleep(seconds)

    def stop(self) -> Receipt:
        """Stop and latch.

        Without a reply within 40 ms the stop word is pressed, which the servo reads directly.

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
        """Take exclusive control of `what`, as a context: see ClientLease. With `keep_alive`, for
        the environment or the damping, a thread renews it: for a body that waits for a person.

        It ends when this client sends no request for `ttl_s`, and at once when it dies. The
        environment then changes according to `at_end`; damping stays. `take_over`: end the lease of
        another client.

        >>> with device.lease("environment", ttl_s=5, at_end="disable") as lease:
        ...     receipt = device.set(K=100)
        ...     lease.sleep(10)
        """
        asked = {"ttl_s": ttl_s, "at_end": at_end, "take_over": take_over or None}
        return ClientLease(self.call, what, keep_alive, self._pause, **asked)

    def perturb_load(self, samples_n: "ArrayLike") -> int:
        """Load a waveform: force [N] at 4 kHz, shape (n,). Return the number of samples in the
        daemon.

        CommandError for a sample beyond the limits of the probe, or while a waveform is playing.

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
        """Perform `steps`, made by `step`, in order and at their ticks; return a receipt for each:
        see `hapticd.client.sequence`.

        CommandError if a step is impossible; nothing is sent then. SequenceError if the sequence
        ended before the last step, by a refusal or a lost daemon. Force is then switched off, or
        stopped, or left as it was with "hold". A lost daemon is stopped by the stop word, except
        with "hold". `lead_s` is the time before its tick at which a step is sent (default: half a
        second). Each `GuardWarning` is emitted at the end.

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
