"""Telemetry and requests of the clients, as bytes and as messages.

Telemetry (`Subscription`, `TelemetryReader`). The one gives raw messages of a SUB socket, the other
the blocks and events in them. The socket connects to the socket file of a daemon on this computer
(`client`), or to the port of one on another (`listener`). The messages are the same.

Only one thread may use the socket, since a ZeroMQ socket belongs to one.

Requests (`RequestTracker`). They and their replies are bytes. The caller passes the time, and a
time-out is a value. Each request has a number that its reply repeats. So a reply that arrives after
its time-out is recognised and dropped, and never taken for the answer to a later request. The
synchronous client (`client`) and that of asyncio (`aio`) transport these bytes in two ways.

Each socket must have one tracker, since every tracker counts from 1.
"""

import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import msgpack
import zmq

from hapticd.core.errors import CommandError, ConfigError, DaemonDown, HapticdError, MailboxError
from hapticd.core.units import NS_PER_S
from hapticd.mailbox.daemons import down, instance_of, press_stop
from hapticd.mailbox.files import COMMAND_SOCKET
from hapticd.protocol.answers import Event, GuardVerdict, Receipt, answer_of
from hapticd.protocol.codec import MAX_MESSAGE_BYTES

if TYPE_CHECKING:
    from hapticd.client.blocks import Block
    from hapticd.core.arrays import Records

__all__ = ["accepted", "receipt_of"]

# --- requests -------------------------------------------------------------------------------------
PROTOCOL_VERSION = 1
STOP_TIMEOUT_S = 0.04  # then the stop word is pressed: force off must not wait for a gateway


class TimedOut(NamedTuple):
    """No reply arrived in time. It is unknown whether the command acts."""

    cmd: str  # name of the command
    waited_s: float


Context = zmq.Context[Any]
Outcome = dict[str, Any] | TimedOut | None  # a reply, no reply in time, or not yet


class _Asked(NamedTuple):
    """A request without a reply so far.

    Times are those of the caller's clock.
    """

    cmd: str
    asked_ns: int
    deadline_ns: int


class RequestTracker:
    """Numbers requests and matches replies."""

    def __init__(self) -> None:
        self._last = 0
        self._asked: dict[int, _Asked] = {}
        self._replies: dict[int, dict[str, Any]] = {}

    def ask(
        self, cmd: str, fields: dict[str, Any], now_ns: int, timeout_ns: int
    ) -> tuple[int, bytes]:
        """Return the number and the bytes of a new request; fields that are None are left out.

        CommandError for more bytes than a request may have.
        """
        given = {name: value for name, value in fields.items() if value is not None}
        request = {"cmd": cmd, "v": PROTOCOL_VERSION, "id": self._last + 1, **given}
        payload = bytes(msgpack.packb(request, default=_python_number))
        if len(payload) > MAX_MESSAGE_BYTES:
            limit = f"a request has at most {MAX_MESSAGE_BYTES}; send less at once"
            raise CommandError("malformed", f"{cmd}: {len(payload)} bytes, {limit}")
        self._last += 1
        self._asked[self._last] = _Asked(cmd, now_ns, now_ns + timeout_ns)
        return self._last, payload

    def introduction(self, name: str) -> bytes:
        """Return the bytes of a hello; its reply is not awaited, so `receive` drops it."""
        number, payload = self.ask("hello", {"name": name}, 0, 0)
        self.forget(number)
        return payload

    def receive(self, payload: bytes) -> None:
        """Accept a reply; drop it if it is unexpected or malformed."""
        try:
            content = msgpack.unpackb(payload)
        except (ValueError, msgpack.UnpackException):
            return
        if isinstance(content, dict) and content.get("id") in self._asked:
            self._replies[content["id"]] = content

    def outcome(self, number: int, now_ns: int) -> Outcome:
        """Return the reply to request `number`, a TimedOut, or None while there is still time."""
        asked = self._asked[number]
        reply = self._replies.pop(number, None)
        if reply is None and now_ns < asked.deadline_ns:
            return None
        del self._asked[number]
        return (
            reply
            if reply is not None
            else TimedOut(asked.cmd, (now_ns - asked.asked_ns) / NS_PER_S)
        )

    def forget(self, number: int) -> None:
        """Stop waiting for the reply to `number`."""
        self._asked.pop(number, None)
        self._replies.pop(number, None)


def _python_number(value: Any) -> Any:
    """Return a numpy number as a Python number, so that values may come from arrays.

    msgpack calls this for values that it cannot pack. CommandError for an int beyond 64 bits,
    TypeError if it is not a number.
    """
    if isinstance(value, int):
        bits = value.bit_length()
        reason = f"an integer of {bits} bits cannot be sent, limit 64; no parameter is so large"
        raise CommandError("malformed", reason)
    if not hasattr(value, "item"):
        raise TypeError(f"{value!r} cannot be sent; use numbers, text, lists and maps")
    return value.item()


def accepted(reply: dict[str, Any]) -> dict[str, Any]:
    """Return `reply` if it is ok.

    DaemonDown if the gateway has no servo; CommandError for any other refusal.
    """
    if reply.get("ok"):
        return reply
    error = reply.get("error", {})
    code = error.get("code", "unknown")
    if code == "servo_down":
        raise DaemonDown(error.get("message", "the servo does not run"))
    reason = error.get("message", "no reason given")
    verdict = error.get("guard")
    raise CommandError(
        code, reason, error.get("detail"), verdict and answer_of(GuardVerdict, verdict)
    )


def receipt_of(reply: dict[str, Any]) -> Receipt:
    """Return the receipt in an accepted reply."""
    content = {"state": reply["state"], "guard": reply.get("guard") or None}
    return answer_of(Receipt, {**reply["receipt"], **content})


def silence(outcome: TimedOut, folder: Path) -> DaemonDown:
    """Return the error for a request to the daemon in `folder` without an answer."""
    waited = f"no reply from {folder} within {outcome.waited_s:.2g} s"
    return DaemonDown(f"{outcome.cmd}: {waited}; is `hapticd run` running there?")


def quiet(topic: str, folder: Path, timeout_s: float) -> DaemonDown:
    """Return the error for `topic` of the daemon in `folder`, silent for `timeout_s`."""
    return DaemonDown(f"{topic}: nothing from {folder} for {timeout_s} s; see `hapticd status`")


def not_reached(wanted: str, found: str, timeout_s: float) -> CommandError:
    """Return the error for a servo in state `found` instead of `wanted` after `timeout_s`."""
    reason = f"state is {found!r}, not {wanted!r}, after {timeout_s} s"
    return CommandError("timeout", f"{reason}; see `hapticd status`")


def check_topic(topic: str) -> None:
    """Raise ConfigError if no daemon publishes `topic`."""
    from hapticd.protocol.telemetry import NAMES  # numpy, which a verb at the shell does not load

    if topic not in NAMES:
        raise ConfigError(f"topic {topic!r} is unknown; topics are {', '.join(sorted(NAMES))}")


def message_of(topic: str, payload: bytes) -> Any:
    """Return a message of `topic`: an `Event`, or a map."""
    plain = msgpack.unpackb(payload)
    return answer_of(Event, plain) if topic == "event" else plain


def heard_with(topic: str) -> set[str]:
    """Return the topics to subscribe to for `topic`. Events may be rare; the state, sent every
    second, shows that the gateway lives.
    """
    return {topic, "state"} if topic == "event" else {topic}


def pressed(folder: Path) -> Receipt:
    """Press the stop word of the daemon in `folder`. DaemonDown if there is no servo either."""
    try:
        press_stop(folder)
    except MailboxError as error:
        raise DaemonDown(str(error)) from error
    return Receipt("pressed")


def command_socket(context: Context, folder: Path) -> tuple[Any, Any]:
    """Return the command socket of the daemon in `folder`, and one with a message for each new
    connection. DaemonDown if there is none.

    Requests are sent only to a connected gateway (IMMEDIATE): one that starts later finds no old
    commands.
    """
    path = socket_file(folder, COMMAND_SOCKET)
    socket = context.socket(zmq.DEALER)
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.IMMEDIATE, 1)
    made = socket.get_monitor_socket(zmq.EVENT_CONNECTED)
    socket.connect(f"ipc://{path}")
    return socket, made


def socket_file(folder: Path, name: str) -> Path:
    """Return the socket `name` of the daemon in `folder`. DaemonDown if there is none."""
    path = folder / name
    if not path.exists():
        raise down(f"{path}: ", instance_of(folder))
    return path


# --- telemetry ------------------------------------------------------------------------------------
MESSAGES_QUEUED = 10_000  # per subscription, before ZeroMQ drops the newest
IDLE_MS = 100


class Subscription:
    """Topics of one endpoint; a subclass defines the endpoint and the meaning of silence."""

    def __init__(self) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()

    def close(self) -> None:
        """Close all sockets; may be called twice."""
        self._context.destroy(linger=0)

    def listen(self, topic: str, timeout_s: float) -> Generator[bytes, None, None]:
        """Yield payloads of exactly `topic`. After silence for `timeout_s` raise the error that
        explains it.
        """
        with self._subscribed(heard_with(topic)) as socket:
            while socket.poll(round(1000 * timeout_s)):
                name, payload = socket.recv_multipart()
                if name == topic.encode():  # ZeroMQ matches prefixes: `servo` includes `servo.raw`
                    yield payload
            raise self._quiet(topic, timeout_s)

    def listen_all(
        self, topics: Sequence[str], look_s: float
    ) -> Generator[tuple[str, bytes] | None, None, None]:
        """Yield (topic, payload) of several topics as they arrive, None after each look; it never
        ends.

        It looks every `look_s` and sleeps in between: waking for every message costs more than
        reading them. With 0 it wakes for each message, and a look ends after a silence of IDLE_MS.
        """
        wanted = {topic.encode(): topic for topic in topics}
        with self._subscribed(set(topics)) as socket:
            socket.setsockopt(zmq.RCVTIMEO, IDLE_MS)
            while True:
                if look_s:
                    time.sleep(look_s)
                with suppress(zmq.Again):
                    while True:
                        name = socket.recv(zmq.NOBLOCK if look_s else 0)
                        payload = socket.recv()  # a message arrives as a whole
                        if name in wanted:
                            yield wanted[name], payload
                yield None

    @contextmanager
    def _subscribed(self, topics: set[str]) -> "Iterator[zmq.Socket[bytes]]":
        endpoint = self._endpoint()
        socket = self._context.socket(zmq.SUB)
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.RCVHWM, MESSAGES_QUEUED)
        for topic in topics:
            socket.setsockopt_string(zmq.SUBSCRIBE, topic)
        try:
            self._prepare(socket)
            socket.connect(endpoint)
            yield socket
        finally:
            self._release(socket)
            socket.close()

    def _endpoint(self) -> str:
        """Return the endpoint. DaemonDown if there is no daemon."""
        raise NotImplementedError

    def _prepare(self, socket: "zmq.Socket[bytes]") -> None:
        """Prepare a socket before it connects: nothing to do on this computer."""

    def _release(self, socket: "zmq.Socket[bytes]") -> None:
        """Close resources opened by `_prepare`."""

    def _quiet(self, topic: str, timeout_s: float) -> HapticdError:
        """Return the error for a silent topic."""
        raise NotImplementedError


class TelemetryReader:
    """Streams and messages of a subscription; a context that closes it."""

    _connection: Subscription
    _timeout_s: float  # of silence

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection; may be called twice.

        >>> device.close()
        """
        self._connection.close()

    def stream(
        self, topic: str = "servo.raw", seconds: float | None = None, count: int | None = None
    ) -> "Generator[Block, None, None]":
        """Yield blocks of `servo.raw` (one record a tick) or `probe` (4 kHz) as they arrive: see
        Block.

        `seconds` of recorded time or `count` records, the last block cut to fit; without either,
        until you stop. DaemonDown after silence for the client's time-out; ConfigError for a topic
        without blocks (see `listen`).

        >>> [len(block.records) for block in device.stream(count=50)]
        [20, 20, 10]
        """
        from hapticd.client.blocks import Excerpt

        excerpt = Excerpt(topic, seconds, count)
        for payload in self._payloads(topic):
            block = excerpt.next(payload)
            if len(block.records):
                yield block
            if excerpt.complete:
                return

    def record(self, seconds: float, topic: str = "servo.raw") -> "tuple[Records, int]":
        """Return all records of the next `seconds` in one structured array (n,), and the number
        lost in transit. Field names contain the units. A slot lost by the servo (its counter
        `lost_slots`) has no record.

        ConfigError and DaemonDown as for `stream`.

        >>> records, lost = device.record(seconds=0.5)
        >>> records["position_m"].shape, lost
        ((500,), 0)
        """
        from hapticd.client.blocks import concatenated

        return concatenated(list(self.stream(topic, seconds=seconds)))

    def listen(self, topic: str) -> Generator[Any, None, None]:
        """Yield decoded messages of `state`, `event` (each an `Event`) or `servo` as they arrive.

        ConfigError for an unknown topic. DaemonDown if the daemon is silent for the client's
        time-out.

        >>> next(device.listen("state"))["state"]
        'disabled'
        """
        check_topic(topic)
        for payload in self._payloads(topic):
            yield message_of(topic, payload)

    def _payloads(self, topic: str) -> Generator[bytes, None, None]:
        """Return the messages of `topic` as they arrive; after silence raise the error with the
        reason.
        """
        return self._connection.listen(topic, self._timeout_s)

    def messages(
        self, topics: Sequence[str], look_s: float = 0.05
    ) -> Generator[tuple[str, bytes] | None, None, None]:
        """Yield raw (topic, payload) of several topics, endlessly; None after each look.

        A look every `look_s` returns all messages received since the last one; with 0 each comes at
        once, and None after a silence.

        >>> topic, payload = next(device.messages(["servo.raw"]))
        >>> topic
        'servo.raw'
        """
        yield from self._connection.listen_all(topics, look_s)
