"""Telemetry for clients: raw messages of a SUB socket (`Subscription`), and the blocks and events
in them (`TelemetryReader`).

The socket connects to the socket file of a daemon on this computer (`client`), or to the port of
one on another (`listener`). The messages are the same.

Only one thread may use it, since a ZeroMQ socket belongs to one.
"""

import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, Self

import zmq

from hapticd.client.requests import check_topic, heard_with, message_of
from hapticd.core.errors import HapticdError

if TYPE_CHECKING:
    from hapticd.client.blocks import Block, Records

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
