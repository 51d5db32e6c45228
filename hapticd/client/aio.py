"""The client for asyncio: the commands of `Client`, each of them awaited.

    async with AsyncClient() as device:
        await device.set(K=100, B=1)
        async for block in device.stream(seconds=1.0):
            ...

Several tasks may send requests at the same time: one task reads all replies, and wakes the waiting
tasks when one arrives. So a stop does not wait for other answers, and after 40 ms the stop word is
pressed, as in the synchronous client.

Only one event loop may use it, since a socket belongs to one. Tasks must yield within the life of a
lease.
"""

import asyncio
import time
from collections.abc import AsyncGenerator, Awaitable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import zmq
import zmq.asyncio
from numpy.typing import ArrayLike

from hapticd.client.blocks import Block, Excerpt, concatenated
from hapticd.client.client import RENEWALS, lost_error, renews_again
from hapticd.client.commands import Ask, Commands, Exchange, Pause, T, hand_event, loaded, reached
from hapticd.client.sequence import AtRefusal, Step, StepReceipt
from hapticd.client.telemetry import (
    STOP_TIMEOUT_S,
    RequestTracker,
    TimedOut,
    accepted,
    check_topic,
    command_socket,
    heard_with,
    message_of,
    pressed,
    quiet,
    receipt_of,
    silence,
    socket_file,
)
from hapticd.core.arrays import Records
from hapticd.core.errors import CommandError, DaemonDown, HapticdError
from hapticd.core.params import AtEnd, Leased
from hapticd.core.units import NS_PER_S
from hapticd.mailbox.files import COMMAND_SOCKET, TELEMETRY_SOCKET
from hapticd.protocol.answers import (
    Coupling,
    Event,
    Get,
    GuardStatus,
    GuardVerdict,
    Hello,
    Receipt,
    Status,
)

__all__ = ["AsyncClient"]

Answer = dict[str, Any]


class AsyncConnection:
    """Sockets to the gateway of a runtime folder, and the task that reads its replies."""

    def __init__(self, folder: Path, name: str) -> None:
        self._folder = folder
        self._name = name
        self._requests = RequestTracker()
        self._context = zmq.asyncio.Context()
        self._socket: zmq.asyncio.Socket | None = None
        self._made: zmq.asyncio.Socket  # a message for each new connection
        self._reading: asyncio.Task[None] | None = None
        self._came = asyncio.Condition()

    async def close(self) -> None:
        """Close all sockets; may be called twice."""
        if self._reading is not None:
            self._reading.cancel()
            with suppress(asyncio.CancelledError):
                await self._reading
            self._reading = None
        self._context.destroy(linger=0)

    async def exchange(self, cmd: str, fields: Answer, timeout_s: float) -> Answer:
        """Send a request and return its reply, accepted or not.

        DaemonDown without a reply in time; CommandError if the request is too long.
        """
        socket = self._connected()
        deadline = time.monotonic() + timeout_s
        timeout_ns = round(timeout_s * NS_PER_S)
        number, payload = self._requests.ask(cmd, fields, time.monotonic_ns(), timeout_ns)
        try:
            # with IMMEDIATE it is writable only when connected
            if await _writable(socket, timeout_s):
                await self._meet(socket)
                await _until(deadline, socket.send(payload))
            return await self._reply(number, deadline)
        except BaseException:
            self._requests.forget(number)
            raise

    async def _reply(self, number: int, deadline: float) -> Answer:
        async with self._came:
            while (outcome := self._requests.outcome(number, time.monotonic_ns())) is None:
                await _until(deadline, self._came.wait())
        if isinstance(outcome, TimedOut):
            raise silence(outcome, self._folder)
        return outcome

    def _connected(self) -> zmq.asyncio.Socket:
        """Return the command socket, created on first use."""
        socket_file(self._folder, COMMAND_SOCKET)
        if self._socket is None:
            self._socket, self._made = command_socket(self._context, self._folder)
            self._reading = asyncio.create_task(self._read(self._socket))
        return self._socket

    async def _meet(self, socket: zmq.asyncio.Socket) -> None:
        """Introduce each new connection: it is a new client to the gateway, which may also be a new
        one.
        """
        with suppress(zmq.Again):
            while True:
                await self._made.recv_multipart(zmq.NOBLOCK)
                socket.send(self._requests.introduction(self._name))

    async def _read(self, socket: zmq.asyncio.Socket) -> None:
        while True:
            self._requests.receive(await socket.recv())
            async with self._came:
                self._came.notify_all()

    async def pause(self, seconds: float) -> None:
        """Sleep for `seconds`."""
        await asyncio.sleep(seconds)

    def now_s(self) -> float:
        """Return the time of the clock by which pauses pass."""
        return time.monotonic()

    async def listen(self, topic: str, timeout_s: float) -> AsyncGenerator[bytes, None]:
        """Yield payloads of exactly `topic`. DaemonDown after silence for `timeout_s`."""
        path = socket_file(self._folder, TELEMETRY_SOCKET)
        with self._context.socket(zmq.SUB) as socket:
            socket.setsockopt(zmq.LINGER, 0)
            for one in heard_with(topic):
                socket.setsockopt_string(zmq.SUBSCRIBE, one)
            socket.connect(f"ipc://{path}")
            while await socket.poll(round(1000 * timeout_s)):
                name, payload = await socket.recv_multipart()
                if name == topic.encode():  # ZeroMQ matches prefixes
                    yield payload
        raise quiet(topic, self._folder, timeout_s)


async def _writable(socket: zmq.asyncio.Socket, timeout_s: float) -> bool:
    """Return whether the socket becomes writable within the time."""
    poller = zmq.asyncio.Poller()
    poller.register(socket, zmq.POLLOUT)
    return bool(await poller.poll(max(0, round(1000 * timeout_s))))


async def _until(deadline: float, done: Awaitable[Any]) -> None:
    """Wait for `done`, but no longer than the `deadline` of the clock."""
    with suppress(TimeoutError):
        await asyncio.wait_for(done, max(0.0, deadline - time.monotonic()))


class AsyncClient(
    Commands[
        Awaitable[Receipt],
        Awaitable[Hello],
        Awaitable[Get],
        Awaitable[Status],
        Awaitable[GuardStatus],
        Awaitable[Answer],
        Awaitable[Coupling],
    ]
):
    """One connection to the daemon `instance`, used as an asynchronous context manager.

    Arguments and errors are those of `Client`. In the examples `device` is
    `hapticd.virtual_board().aio()`, disabled, with its active damping on.
    """

    def _connect(self) -> None:
        self._connection = AsyncConnection(self._folder, self._name)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connection; may be called twice.

        >>> await device.close()
        """
        await self._connection.close()

    async def call(self, cmd: str, **fields: Any) -> Answer:
        """Send any command and return its whole reply {ok, id, rev, state, result or receipt}.

        CommandError if the daemon refuses, DaemonDown without an answer in time.

        >>> (await device.call("set", K=50))["receipt"]["effective"]["K"]
        50.0
        """
        asked = self._as_asked(cmd, fields)
        return accepted(await self._connection.exchange(cmd, asked, self._timeout_s))

    async def _carried_out(self, exchange: Exchange[T]) -> T:
        answer = None
        try:
            while True:
                answer = await self._tried(exchange.send(answer))
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]  # what the generator returns

    def _now_s(self) -> float:
        return self._connection.now_s()

    async def _tried(self, due: Ask | Pause) -> Any:
        """Return the reply to a request, or its error; None after a pause."""
        try:
            if isinstance(due, Pause):
                return await self._connection.pause(due.seconds)
            return await (self.stop() if due.cmd == "stop" else self.call(due.cmd, **due.fields))
        except (CommandError, DaemonDown) as error:
            return error

    async def stop(self) -> Receipt:
        """Stop and latch; without a reply within 40 ms, press the stop word. DaemonDown if there is
        no servo either.

        DaemonDown if there is no servo either.

        >>> (await device.stop()).state
        'stopped'
        """
        try:
            return receipt_of(accepted(await self._connection.exchange("stop", {}, STOP_TIMEOUT_S)))
        except (DaemonDown, CommandError):
            return pressed(self._folder)

    def lease(
        self,
        what: Leased,
        *,
        ttl_s: float | None = None,
        at_end: AtEnd | None = None,
        take_over: bool = False,
    ) -> "AsyncLease":
        """Take exclusive control of `what`, as an asynchronous context: see AsyncLease.

        >>> async with device.lease("environment", at_end="disable"):
        ...     receipt = await device.set(K=100)
        """
        return AsyncLease(self, what, ttl_s=ttl_s, at_end=at_end, take_over=take_over or None)

    async def perturb_load(self, samples_n: ArrayLike) -> int:
        """Load a waveform: force [N] at 4 kHz, shape (n,). Return the number of samples in the
        daemon.

        CommandError as for `Client.perturb_load`.

        >>> await device.perturb_load(0.1 * np.ones(4000))
        4000
        """
        return await self._carried_out(loaded(samples_n))

    async def sequence(
        self,
        steps: Sequence[Step],
        at_refusal: AtRefusal = "disable",
        lead_s: float | None = None,
    ) -> tuple[StepReceipt, ...]:
        """Perform `steps` in order and at their ticks, as `Client.sequence`; return a receipt for
        each.

        CommandError if a step is impossible (nothing is sent); SequenceError if it ended early.

        >>> steps = [step("enable"), step("set", K=100, after_s=0.5), step("disable", after_s=1)]
        >>> [one.result for one in await device.sequence(steps)]
        ['applied', 'applied', 'applied']
        """
        return await self._carried_out(self._sequence(steps, at_refusal, lead_s))

    async def hand(self, verdict: GuardVerdict, timeout_s: float = 1.0) -> Event | None:
        """Return the event that describes the hand for which the change of `verdict` is unstable;
        None if `timeout_s` passes first.

        >>> receipt = await device.set(K=-100)
        >>> (await device.hand(receipt.guard)).text
        '...'
        """
        return await self._carried_out(hand_event(verdict, timeout_s))

    async def wait_for(self, state: str, timeout_s: float = 10.0) -> None:
        """Return when the servo is in `state`, as `Client.wait_for`.

        >>> receipt = await device.enable()
        >>> await device.wait_for("enabled")
        """
        await self._carried_out(reached(state, timeout_s))

    async def stream(
        self, topic: str = "servo.raw", seconds: float | None = None, count: int | None = None
    ) -> AsyncGenerator[Block, None]:
        """Yield blocks of `servo.raw` or `probe` as they arrive, as `Client.stream`, with its
        errors.

        >>> [len(block.records) async for block in device.stream(count=50)]
        [20, 20, 10]
        """
        excerpt = Excerpt(topic, seconds, count)
        async for payload in self._connection.listen(topic, self._timeout_s):
            block = excerpt.next(payload)
            if len(block.records):
                yield block
            if excerpt.complete:
                return

    async def record(self, seconds: float, topic: str = "servo.raw") -> tuple[Records, int]:
        """Return all records of the next `seconds` in one structured array (n,), and the number
        lost.

        Field names contain the units. ConfigError and DaemonDown as for `stream`.

        >>> records, lost = await device.record(seconds=0.5)
        >>> records["position_m"].shape, lost
        ((500,), 0)
        """
        return concatenated([block async for block in self.stream(topic, seconds=seconds)])

    async def listen(self, topic: str) -> AsyncGenerator[Any, None]:
        """Yield decoded messages of `state`, `event` (each an `Event`) or `servo` as they arrive.

        ConfigError for an unknown topic. DaemonDown if the daemon is silent for the client's
        time-out.

        >>> async for message in device.listen("state"):
        ...     print(message["state"])
        ...     break
        disabled
        """
        check_topic(topic)
        async for payload in self._connection.listen(topic, self._timeout_s):
            yield message_of(topic, payload)


class AsyncLease:
    """A lease of `what`, taken at the begin of the context and released at its end. An exception in
    the context triggers the action `at_end`.

    A separate task renews it, so it is lost when the event loop hangs, not while the body waits.
    CommandError at the end of the context if it was lost.
    """

    def __init__(self, client: AsyncClient, what: str, **asked: Any) -> None:
        self._client = client
        self._what = what
        self._asked = asked
        self._renewing: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        held = (await self._client.call("lease", what=self._what, **self._asked))["result"]
        self._renewing = asyncio.create_task(self._renew(held["ttl_s"]))
        return self

    async def __aexit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._renewing is not None:
            self._renewing.cancel()
            await asyncio.gather(self._renewing, return_exceptions=True)
        try:
            action = "release" if kind is None else "fail"
            reply = await self._client.call("lease", what=self._what, action=action)
        except Exception:
            if kind is None:
                raise
            return  # the exception in the context has precedence
        if not reply["result"]["released"] and kind is None:
            raise lost_error(str(reply["result"]["text"]))

    async def _renew(self, ttl_s: float) -> None:
        """Renew the lease until it is lost; the end of the context reports that."""
        while True:
            await asyncio.sleep(ttl_s / RENEWALS)
            try:
                await self._client.call("lease", what=self._what, action="renew")
            except HapticdError as error:
                if not renews_again(error):
                    return
