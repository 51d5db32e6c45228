"""Rigs for tests of gateway and client: the substitute servo, virtual time, and either the command
server alone or the whole gateway.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Self

import msgpack
import zmq

from hapticd.core.params import LeaseParams
from hapticd.core.units import NS_PER_MS, NS_PER_S, VirtualClock
from hapticd.gateway.command_server import CommandServer
from hapticd.gateway.server import GatewayServer
from hapticd.guard.status import Guard
from hapticd.guard.worker import Start, Worker
from hapticd.protocol.codec import Encoding, encode
from hapticd.protocol.journal import Journal
from hapticd.protocol.view import ServoView
from support.gateway_stand_in import StandInServo, setup

START_NS = 1000 * NS_PER_S
UNIX_NS = 1_800_000_000 * NS_PER_S
PATIENCE = 20_000  # passes of a loop that waits for ZeroMQ's own threads


def packed(**fields: Any) -> bytes:
    """A msgpack request."""
    return encode(Encoding.MSGPACK, fields)


class CommandServerRig:
    """A servo with a command server, without sockets. `ask` plays a client that waits for its
    reply.
    """

    def __init__(self, folder: Path, worker: Worker | None = None) -> None:
        self.folder = folder
        self.worker = worker
        self.clock = VirtualClock(START_NS)
        self.servo = StandInServo(folder, self.clock)
        self.setup = setup()
        self.start_gateway()
        self.run(2)

    def start_gateway(self, lease: LeaseParams | None = None) -> None:
        """Replace the command server by one without state."""
        self.journal = Journal(lambda: UNIX_NS)
        self.view = ServoView(self.folder, self.setup.servo, lambda: UNIX_NS)
        self.guard = Guard(self.view, self.journal, self.setup.guard, self.worker)
        self.server = CommandServer(
            self.view, self.journal, lambda cmd: {"asked": cmd}, self.guard, lease
        )

    def run(self, ticks: int = 1) -> list[list[bytes]]:
        """Run `ticks` and return the due replies."""
        self.servo.tick(ticks)
        return self.look()

    def look(self) -> list[list[bytes]]:
        """Let the command server read the servo without a tick."""
        self.view.refresh(self.clock.now_ns())
        return self.server.collect(self.clock.now_ns())

    def send(self, *payloads: bytes, client: bytes = b"a") -> list[dict[str, Any]]:
        """Send requests that arrive together; return the immediate replies."""
        return [
            decoded(reply)
            for reply in self.server.serve(
                [[client, payload] for payload in payloads], self.clock.now_ns()
            )
        ]

    def ask(self, client: bytes = b"a", **fields: Any) -> dict[str, Any]:
        """One request and its reply, after at most three ticks."""
        replies = self.send(packed(**fields), client=client)
        for _ in range(3):
            replies = replies or [decoded(reply) for reply in self.run()]
        (reply,) = replies
        return reply

    def pass_time(self, ms: int) -> list[list[bytes]]:
        """Virtual time without ticks."""
        self.clock.time_ns += ms * NS_PER_MS
        return self.look()


def decoded(frames: list[bytes]) -> Any:
    """The content of a reply."""
    return msgpack.unpackb(frames[-1])


class GatewayRig:
    """A servo and a whole gateway with its sockets, stepped by hand. Sockets created here are
    closed with it.
    """

    def __init__(self, folder: Path, start_worker: Start | None = None, **options: Any) -> None:
        self.folder, self.clock = folder, VirtualClock(START_NS)
        self.servo = StandInServo(folder, self.clock)
        self._begin = partial(
            GatewayServer, folder, setup(**options), self.clock, lambda: UNIX_NS, start_worker
        )
        self.gateway = self._begin()
        self.context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._sockets: list[zmq.Socket[bytes]] = []  # a context holds only weak references
        self.lock = threading.Lock()  # held while the rig steps
        self.servo_stands = False
        self.step()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.context.destroy(linger=0)
        self.gateway.close()

    def step(self, ticks: int = 5) -> None:
        """`ticks` of the servo, then one pass of the gateway."""
        with self.lock:
            self.servo.tick(0 if self.servo_stands else ticks)
            self.gateway.step(0)

    def restart_gateway(self) -> None:
        """Replace the gateway; the servo continues."""
        with self.lock:
            self.gateway.close()
            self.gateway = self._begin()

    def socket(self, kind: int, endpoint: str, **options: Any) -> "zmq.Socket[bytes]":
        """A connected socket; options by their ZeroMQ names."""
        socket = self.context.socket(kind)
        self._sockets.append(socket)
        socket.setsockopt(zmq.LINGER, 0)
        for name, value in options.items():
            socket.setsockopt(getattr(zmq, name), value)
        socket.connect(endpoint)
        return socket

    def client(self, kind: int = zmq.DEALER) -> "zmq.Socket[bytes]":
        """A connected socket for commands."""
        return self.socket(kind, str(self.gateway.endpoints["command"]))

    def subscriber(self, topic: str, **options: Any) -> "zmq.Socket[bytes]":
        """A SUB socket on the socket file."""
        endpoint = self.gateway.endpoints["telemetry"][0]  # type: ignore[index]
        return self.socket(zmq.SUB, endpoint, SUBSCRIBE=topic.encode(), **options)

    def receive(self, socket: "zmq.Socket[bytes]", ticks: int = 5) -> list[bytes]:
        """The next message of `socket`, while servo and gateway go on."""
        for _ in range(PATIENCE):
            if socket.poll(1):
                return socket.recv_multipart()
            self.step(ticks)
        raise AssertionError("nothing came")

    def ask(self, socket: "zmq.Socket[bytes]", **fields: Any) -> Any:
        """One request and its reply."""
        socket.send(packed(**fields))
        return decoded(self.receive(socket))


@contextmanager
def running(rig: GatewayRig, ticks: int = 5) -> Iterator[GatewayRig]:
    """Servo and gateway of `rig` go on in a thread of their own, in virtual time, for clients
    that block.
    """
    ended = threading.Event()

    def go() -> None:
        while not ended.is_set():
            rig.step(ticks)
            ended.wait(0.0002)

    thread = threading.Thread(target=go)
    thread.start()
    try:
        yield rig
    finally:
        ended.set()
        thread.join()
