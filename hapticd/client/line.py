"""The client's line to the gateway: a DEALER socket for the conversation, a SUB socket per topic that is listened to.

Requests are given only to a gateway that is connected (IMMEDIATE), so one that starts later finds no old commands in its
queue; nothing lingers when the line is closed. Not for use from several threads.
"""

import time
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import zmq

from hapticd.client.core import Conversation, TimedOut
from hapticd.errors import CommandError, DaemonDown
from hapticd.gateway.codec import MAX_MESSAGE_BYTES
from hapticd.mailbox.files import COMMAND_SOCKET, TELEMETRY_SOCKET
from hapticd.units import NS_PER_S

INTRODUCTION_MS = 40
MESSAGES_QUEUED = 10_000


class Line:
    """Sockets to the gateway of a runtime folder; made when they are first needed."""

    def __init__(self, folder: Path, name: str) -> None:
        self._folder, self._name = folder, name
        self._conversation = Conversation()
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket: zmq.Socket[bytes] | None = None

    def close(self) -> None:
        """Close all sockets; may be called twice."""
        self._context.destroy(linger=0)

    def exchange(self, cmd: str, fields: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        """Send a request; its reply, accepted or not. DaemonDown if none comes in time, CommandError if it is too long."""
        socket = self._connected()
        number, payload = self._conversation.ask(cmd, fields, time.monotonic_ns(), round(timeout_s * NS_PER_S))
        if len(payload) > MAX_MESSAGE_BYTES:
            raise CommandError(
                "malformed", f"{cmd}: {len(payload)} bytes, a request has at most {MAX_MESSAGE_BYTES}; send less at once"
            )
        unsent: list[bytes] = [payload]
        deadline = time.monotonic() + timeout_s
        while (outcome := self._conversation.outcome(number, time.monotonic_ns())) is None:
            wait_ms = max(0, round(1000 * (deadline - time.monotonic())))
            if unsent:
                if socket.poll(wait_ms, zmq.POLLOUT):
                    socket.send(unsent.pop())
            elif socket.poll(wait_ms):
                self._conversation.hear(socket.recv())
        if isinstance(outcome, TimedOut):
            raise DaemonDown(
                f"{cmd}: no reply from {self._folder} within {outcome.waited_s:.2g} s; is `hapticd run` running there?"
            )
        return outcome

    def _connected(self) -> "zmq.Socket[bytes]":
        """The command socket; made, and the client introduced, when it is first needed."""
        path = self._folder / COMMAND_SOCKET
        if not path.exists():
            raise DaemonDown(f"{path}: no daemon runs there; start it with `hapticd run`")
        if self._socket is None:
            self._socket = self._context.socket(zmq.DEALER)
            self._socket.setsockopt(zmq.LINGER, 0)
            self._socket.setsockopt(zmq.IMMEDIATE, 1)
            self._socket.connect(f"ipc://{path}")
            self._introduce(self._socket)
        return self._socket

    def _introduce(self, socket: "zmq.Socket[bytes]") -> None:
        number, payload = self._conversation.ask("hello", {"name": self._name}, 0, 0)
        self._conversation.forget(number)
        if socket.poll(INTRODUCTION_MS, zmq.POLLOUT):
            socket.send(payload)

    def listen(self, topic: str, timeout_s: float) -> Generator[bytes, None, None]:
        """Payloads of exactly `topic` (the prefix `servo` brings `servo.raw` as well). DaemonDown after silence for `timeout_s`.

        `event` may be silent for long; there, `state` shows that the gateway lives.
        """
        with self._subscribed({topic, "state"} if topic == "event" else {topic}) as socket:
            while socket.poll(round(1000 * timeout_s)):
                name, payload = socket.recv_multipart()
                if name == topic.encode():
                    yield payload
        raise DaemonDown(f"{topic}: nothing from {self._folder} for {timeout_s} s; see `hapticd status`")

    def listen_all(self, topics: Sequence[str], look_s: float) -> Generator[tuple[str, bytes] | None, None, None]:
        """(topic, payload) of several topics in the order in which they come, None after all that came within `look_s`; for ever.

        It sleeps between its looks: being woken by every message would cost more than taking them.
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
        path = self._folder / TELEMETRY_SOCKET
        if not path.exists():
            raise DaemonDown(f"{path}: no daemon runs there; start it with `hapticd run`")
        socket = self._context.socket(zmq.SUB)
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.RCVHWM, MESSAGES_QUEUED)
        for topic in topics:
            socket.setsockopt_string(zmq.SUBSCRIBE, topic)
        socket.connect(f"ipc://{path}")
        return socket
