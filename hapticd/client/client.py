"""The client: one connection to a running daemon; synchronous, one thread, never waiting for ever.

`GatewayLine` holds the sockets: a DEALER for the conversation (`conversation`), a SUB per
subscription. Requests are given only to a gateway that is connected (IMMEDIATE), so one that starts
later finds no old commands in its queue; nothing lingers when the line is closed. `Client` gives
every command a method: those of one request are `verbs`, which asyncio has as well (`aio`).

Every call ends within its time-out, with a reply, a CommandError (the daemon refused: `code` and
`detail` say why) or DaemonDown (nobody answers, or the gateway has no servo).

numpy is loaded by what needs it, streams and waveforms: a verb at the shell does not wait for it.

What would break it: use from several threads, since a ZeroMQ socket belongs to one; and waiting for
a reply without a deadline, since a gateway may die between request and reply.
"""

import time
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import msgpack
import zmq

from hapticd.client.conversation import (
    INTRODUCTION_MS,
    STOP_TIMEOUT_S,
    Conversation,
    Receipt,
    TimedOut,
    accepted,
    receipt_of,
    silence,
    socket_file,
)
from hapticd.client.lease import ClientLease
from hapticd.client.verbs import POLL_S, Verbs, hand_of
from hapticd.errors import CommandError, DaemonDown, MailboxError
from hapticd.mailbox.daemons import daemon_folder
from hapticd.mailbox.files import COMMAND_SOCKET, DEFAULT_INSTANCE, TELEMETRY_SOCKET
from hapticd.mailbox.stop_word import press_stop
from hapticd.units import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from hapticd.client.blocks import Block, Records
    from hapticd.params import AtEnd, Leased

MESSAGES_QUEUED = 10_000  # per subscription, before ZeroMQ drops the newest


class GatewayLine:
    """Sockets to the gateway of a runtime folder; made when they are first needed."""

    def __init__(self, folder: Path, name: str) -> None:
        self._folder = folder
        self._name = name
        self._conversation = Conversation()
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket: zmq.Socket[bytes] | None = None

    def close(self) -> None:
        """Close all sockets; may be called twice."""
        self._context.destroy(linger=0)

    def exchange(self, cmd: str, fields: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        """Send a request; its reply, accepted or not.

        DaemonDown: none in time; CommandError: too long.
        """
        socket = self._connected()
        timeout_ns = round(timeout_s * NS_PER_S)
        number, payload = self._conversation.ask(cmd, fields, time.monotonic_ns(), timeout_ns)
        unsent: list[bytes] = [payload]
        deadline = time.monotonic() + timeout_s
        while (outcome := self._conversation.outcome(number, time.monotonic_ns())) is None:
            # a negative wait would be one for ever
            wait_ms = max(0, round(1000 * (deadline - time.monotonic())))
            if unsent:
                # with IMMEDIATE it can be written to only when it is connected
                if socket.poll(wait_ms, zmq.POLLOUT):
                    socket.send(unsent.pop())
            elif socket.poll(wait_ms):
                self._conversation.receive(socket.recv())
        if isinstance(outcome, TimedOut):
            raise silence(outcome, self._folder)
        return outcome

    def _connected(self) -> "zmq.Socket[bytes]":
        """The command socket; made, and the client introduced, when it is first needed."""
        path = socket_file(self._folder, COMMAND_SOCKET)
        if self._socket is None:
            self._socket = self._context.socket(zmq.DEALER)
            self._socket.setsockopt(zmq.LINGER, 0)
            self._socket.setsockopt(zmq.IMMEDIATE, 1)
            self._socket.connect(f"ipc://{path}")
            self._introduce(self._socket)
        return self._socket

    def _introduce(self, socket: "zmq.Socket[bytes]") -> None:
        number, payload = self._conversation.ask("hello", {"name": self._name}, 0, 0)
        # nobody waits for this reply: `receive` drops it
        self._conversation.forget(number)
        if socket.poll(INTRODUCTION_MS, zmq.POLLOUT):
            socket.send(payload)

    def listen(self, topic: str, timeout_s: float) -> Generator[bytes, None, None]:
        """Payloads of exactly `topic`. DaemonDown after silence for `timeout_s`."""
        # events may be rare: there the state, which comes every second, shows that the gateway
        # lives
        with self._subscribed({topic, "state"} if topic == "event" else {topic}) as socket:
            while socket.poll(round(1000 * timeout_s)):
                name, payload = socket.recv_multipart()
                if (
                    name == topic.encode()
                ):  # ZeroMQ matches prefixes: `servo` brings `servo.raw` too
                    yield payload
        raise DaemonDown(
            f"{topic}: nothing from {self._folder} for {timeout_s} s; see `hapticd status`"
        )

    def listen_all(
        self, topics: Sequence[str], look_s: float
    ) -> Generator[tuple[str, bytes] | None, None, None]:
        """(topic, payload) of several topics as they come, None after each look; it never ends.

        It looks every `look_s` and sleeps in between: being woken by every message would cost more
        than taking them.
        """
        with self._subscribed(set(topics)) as socket:
            while True:
                time.sleep(look_s)
                while socket.poll(0):
                    name, payload = socket.recv_multipart()
                    if name.decode() in topics:
                        yield name.decode(), payload
                yield None

    def _subscribed(self, topics: set[str]) -> "zmq.Socket[bytes]":
        path = socket_file(self._folder, TELEMETRY_SOCKET)
        socket = self._context.socket(zmq.SUB)
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.RCVHWM, MESSAGES_QUEUED)
        for topic in topics:
            socket.setsockopt_string(zmq.SUBSCRIBE, topic)
        socket.connect(f"ipc://{path}")
        return socket


class Client(Verbs[Receipt, dict[str, Any]]):
    """One connection to the daemon `instance`, best used as a context manager.

    `timeout_s` bounds every call; `name` is shown beside what this client changes; `folder` is the
    runtime folder where it is not that of the instance.
    """

    def __init__(
        self,
        instance: str = DEFAULT_INSTANCE,
        timeout_s: float = 2.0,
        name: str = "script",
        folder: Path | None = None,
    ) -> None:
        self._folder = folder or daemon_folder(instance)
        self._timeout_s = timeout_s
        self._name = name
        self._line = GatewayLine(self._folder, name)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give up the connection; may be called twice."""
        self._line.close()

    # --- asking -----------------------------------------------------------------------------------

    def call(self, cmd: str, **fields: Any) -> dict[str, Any]:
        """Send any command; its whole reply {ok, id, rev, state, result or receipt}.

        CommandError where the daemon refuses, DaemonDown where none answers in time.
        """
        return accepted(self._line.exchange(cmd, fields, self._timeout_s))

    def _result(self, cmd: str, **fields: Any) -> dict[str, Any]:
        result: dict[str, Any] = self.call(cmd, **fields)["result"]
        return result

    def _change(self, cmd: str, **fields: Any) -> Receipt:
        return receipt_of(self.call(cmd, **fields))

    # --- changing ---------------------------------------------------------------------------------

    def hand(self, verdict: dict[str, Any], timeout_s: float = 1.0) -> dict[str, Any] | None:
        """The hand that would shake what `verdict` is about: the event `guard` with `text`.

        None if `timeout_s` passes first.
        """
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            if found := hand_of(self.status(), verdict):
                return found
            time.sleep(POLL_S)
        return None

    def stop(self) -> Receipt:
        """Latched stop.

        Without a reply within 40 ms the stop word is pressed, which the servo reads.

        DaemonDown if there is no servo either.
        """
        try:
            return receipt_of(accepted(self._line.exchange("stop", {}, STOP_TIMEOUT_S)))
        except (DaemonDown, CommandError):
            try:
                press_stop(self._folder)
            except MailboxError as error:
                raise DaemonDown(str(error)) from error
            return Receipt("pressed")

    def lease(
        self,
        what: "Leased",
        *,
        ttl_s: float | None = None,
        at_end: "AtEnd | None" = None,
        take_over: bool = False,
    ) -> ClientLease:
        """Be the only one who changes `what`, as a context: see ClientLease.

        It ends when this client asks nothing for `ttl_s`, and at once when it dies; the environment
        then goes as `at_end` says, damping stays. `take_over`: end another's.
        """
        return ClientLease(self.call, what, ttl_s=ttl_s, at_end=at_end, take_over=take_over or None)

    def perturb_load(self, samples_n: "ArrayLike") -> int:
        """Load a waveform: force [N] at 4 kHz, shape (n,). The number of samples the daemon has."""
        from hapticd.client.blocks import chunks

        loaded: int = 0
        for chunk in chunks(samples_n):
            loaded = self._result("perturb", **chunk)["samples"]
        return loaded

    # --- watching ---------------------------------------------------------------------------------

    def wait_for(self, state: str, timeout_s: float = 10.0) -> None:
        """Return when the servo is in `state`.

        CommandError `timeout` or DaemonDown after `timeout_s`.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                found = self.call("get")["state"]
            except DaemonDown:
                if time.monotonic() >= deadline:
                    raise
                # a daemon that is being started does not answer yet
                found = "down"
            if found == state:
                return
            if time.monotonic() >= deadline:
                reason = f"state is {found!r}, not {state!r}, after {timeout_s} s"
                raise CommandError("timeout", f"{reason}; see `hapticd status`")
            time.sleep(POLL_S)

    def stream(
        self, topic: str = "servo.raw", seconds: float | None = None, count: int | None = None
    ) -> "Generator[Block, None, None]":
        """Blocks of `servo.raw` (one record a tick) or `probe` (4 kHz) as they come: see Block.

        `seconds` of recorded time or `count` records, the last block cut to fit; without either,
        until you stop. DaemonDown when nothing comes for the client's time-out; ConfigError for a
        topic without blocks (see `listen`).
        """
        from hapticd.client.blocks import Excerpt

        excerpt = Excerpt(topic, seconds, count)
        for payload in self._line.listen(topic, self._timeout_s):
            block = excerpt.next(payload)
            if len(block.records):
                yield block
            if excerpt.complete:
                return

    def record(self, seconds: float, topic: str = "servo.raw") -> "tuple[Records, int]":
        """All records of the next `seconds` in one structured array (n,), and how many it lacks."""
        from hapticd.client.blocks import joined

        return joined(list(self.stream(topic, seconds=seconds)))

    def listen(self, topic: str) -> Generator[Any, None, None]:
        """Decoded messages of `state`, `event` or `servo` as they come.

        DaemonDown when the daemon is silent for the client's time-out.
        """
        for payload in self._line.listen(topic, self._timeout_s):
            yield msgpack.unpackb(payload)

    def messages(
        self, topics: Sequence[str], look_s: float = 0.05
    ) -> Generator[tuple[str, bytes] | None, None, None]:
        """Raw (topic, payload) of several topics, endlessly; None after each look.

        A look every `look_s` takes all that came meanwhile.
        """
        yield from self._line.listen_all(topics, look_s)
