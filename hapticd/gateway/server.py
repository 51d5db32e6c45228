"""The gateway process: its two sockets, the file that says where they are, and its one loop.

    ROUTER  ipc://<runtime folder>/command     requests and replies
    XPUB    ipc://<runtime folder>/telemetry   topics, for this machine
            tcp://127.0.0.1:9872               the same, where PlotJuggler looks for it

The socket files are for user and group only; the folder decides further. A client that stops
reading fills its own queue (SNDHWM) and loses messages, one that sends too much at once is cut off
(MAXMSGSIZE), one that is silent is dropped after three missed heartbeats. Only the default instance
claims port 9872; where it is taken, any free one serves.

One pass of the loop: tell the servo that the gateway lives, take at most 20 requests (stops first),
give the replies that are due, note subscriptions, and every 10 ms publish what the ring holds. A
pass waits for a socket at most 10 ms; while answers of the servo are outstanding it looks again
after 0.25 ms. Sends never wait: ZeroMQ drops messages to whoever does not read.

What would break it: a pass that takes longer than the servo's patience with the heartbeat (1 s), or
a second gateway in the folder (the claim is taken before anything is bound).
"""

import hashlib
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zmq
from zmq.auth.thread import ThreadAuthenticator

import hapticd
from hapticd.clock import Clock
from hapticd.errors import ConfigError, MailboxError
from hapticd.gateway import auth
from hapticd.gateway.codec import MAX_MESSAGE_BYTES
from hapticd.gateway.desk import Desk
from hapticd.gateway.journal import Journal
from hapticd.gateway.publisher import Publisher, state_map
from hapticd.gateway.schemas import PROTOCOL_VERSION
from hapticd.gateway.telemetry import TOPICS
from hapticd.gateway.view import ServoView
from hapticd.mailbox import files
from hapticd.mailbox.files import (
    COMMAND_SOCKET,
    DEFAULT_INSTANCE,
    ENDPOINTS,
    TELEMETRY_SOCKET,
    remove,
    write_whole,
)
from hapticd.mailbox.layout import LAYOUT_HASH
from hapticd.params import GatewayParams, GatewaySetup, to_plain
from hapticd.units import NS_PER_MS, NS_PER_S, NS_PER_US

# Linux has 108 bytes for it, the last of which is 0
LONGEST_PATH = 107  # of a socket file
REQUESTS_QUEUED = 200
REPLIES_QUEUED = 200
MESSAGES_QUEUED = 100  # per subscriber: 2 s
MAX_SUBSCRIPTION_BYTES = (
    1024  # libzmq keeps some 50 bytes for each; handshakes with keys need several 100
)
HEARTBEAT_MS = 2000
# three heartbeats
SILENCE_MS = 6000
# until a peer that connects and never speaks ZeroMQ is dropped
HANDSHAKE_MS = 3000
# `bind` makes the socket file; this leaves it read and write for user and group
SOCKET_UMASK = 0o117

Context = zmq.Context[zmq.Socket[bytes]]


class Sockets:
    """Both sockets, bound.

    `endpoints` is {command, telemetry: [..], pid}; `warning` is set when telemetry is in the clear.
    """

    def __init__(self, folder: Path, setup: GatewaySetup) -> None:
        self._folder = folder
        params = setup.gateway
        self.warning = auth.warning(params)
        self.context: Context = zmq.Context()
        self._guard: ThreadAuthenticator | None = None
        try:
            self.command = self._socket(
                zmq.ROUTER, {zmq.RCVHWM: REQUESTS_QUEUED, zmq.SNDHWM: REPLIES_QUEUED}
            )
            spoken: dict[int, int] = {
                zmq.SNDHWM: MESSAGES_QUEUED,
                # every subscription is reported, not the first alone: late joiners get `state`
                zmq.XPUB_VERBOSE: 1,
                zmq.MAXMSGSIZE: MAX_SUBSCRIPTION_BYTES,
            }
            self.telemetry = self._socket(zmq.XPUB, spoken)
            self._guard = auth.authenticator(self.context, params)
            self.endpoints = self._bound(params, setup.servo.instance)
        except BaseException:
            self.close()
            raise

    def _socket(self, kind: int, options: dict[int, int]) -> "zmq.Socket[bytes]":
        socket = self.context.socket(kind)
        common = {
            # closing never waits for a client that does not read
            zmq.LINGER: 0,
            zmq.MAXMSGSIZE: MAX_MESSAGE_BYTES,
            zmq.HEARTBEAT_IVL: HEARTBEAT_MS,
            zmq.HEARTBEAT_TIMEOUT: SILENCE_MS,
            zmq.HANDSHAKE_IVL: HANDSHAKE_MS,
        }
        for option, value in (common | options).items():
            socket.setsockopt(option, value)
        return socket

    def _bound(self, params: GatewayParams, instance: str) -> dict[str, object]:
        before = os.umask(SOCKET_UMASK)
        try:
            command = bind_file(self.command, self._folder / COMMAND_SOCKET)
            telemetry = bind_file(self.telemetry, self._folder / TELEMETRY_SOCKET)
        finally:
            os.umask(before)
        if self._guard:
            auth.encrypt(self.telemetry, params)
        tcp = bind_tcp(self.telemetry, params.tcp_host, port_for(params, instance))
        endpoints = {"command": command, "telemetry": [telemetry, tcp], "pid": os.getpid()}
        # last: whoever finds this file may connect
        write_whole(self._folder / ENDPOINTS, json.dumps(endpoints))
        return endpoints

    def close(self) -> None:
        """Close both sockets and remove what says where they were."""
        if self._guard:
            # its thread has a socket of this context, which could not end before it
            self._guard.stop()
        self.context.destroy(linger=0)
        remove(self._folder, ENDPOINTS, COMMAND_SOCKET, TELEMETRY_SOCKET)


def bind_file(socket: "zmq.Socket[bytes]", path: Path) -> str:
    """Bind to a socket file; its endpoint.

    ConfigError when the path is too long for one, MailboxError when it cannot be made.
    """
    if len(os.fsencode(path)) > LONGEST_PATH:
        raise ConfigError(
            f"{path}: {len(os.fsencode(path))} bytes, a socket file has at most {LONGEST_PATH}; use"
            " a shorter folder"
        )
    try:
        socket.bind(f"ipc://{path}")
    except zmq.ZMQError as error:
        raise MailboxError(
            f"{path}: {error.strerror}; make room, correct its rights or remove what is in the way"
        ) from error
    return f"ipc://{path}"


def port_for(params: GatewayParams, instance: str) -> int:
    """The port to try first; 0 (any free one) for other instances than the default one."""
    usual = params.telemetry_port == GatewayParams().telemetry_port
    return 0 if usual and instance != DEFAULT_INSTANCE else params.telemetry_port


def bind_tcp(socket: "zmq.Socket[bytes]", host: str, port: int) -> str:
    """Bind to `port`, or to any free one if it is taken; the endpoint.

    ConfigError if the address is not ours.
    """
    # ZeroMQ wants brackets around an IPv6 address, and `*` for any free port
    address = f"tcp://[{host}]" if ":" in host else f"tcp://{host}"
    try:
        socket.bind(f"{address}:{port or '*'}")
    except zmq.ZMQError as error:
        if error.errno != zmq.EADDRINUSE or port == 0:
            raise ConfigError(
                f"gateway.tcp_host = {host!r}: {error}; name an address of this machine"
            ) from error
        return bind_tcp(socket, host, 0)
    return socket.getsockopt_string(zmq.LAST_ENDPOINT)


DRAIN_MS = 10
PEEK_NS = 250 * NS_PER_US  # between looks for an outstanding answer
REQUESTS_PER_PASS = 20
SUBSCRIPTIONS_PER_PASS = 100
STANDSTILL_NS = NS_PER_S  # a pass that comes so late finds requests whose senders have given up
SETTLING_NS = 100 * NS_PER_MS  # until ZeroMQ's own thread has handed over all of them


class GatewayServer:
    """One gateway in one runtime folder.

    MailboxError: another one is there; ConfigError: an address or key is wrong.
    """

    def __init__(
        self,
        folder: Path,
        setup: GatewaySetup,
        clock: Clock,
        unix_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._setup = setup
        self._clock = clock
        self._unix_ns = unix_ns
        self._claim = files.claim(files.prepare_folder(folder), files.GATEWAY_LOCK)
        try:
            self._sockets = Sockets(folder, setup)
        except BaseException:
            files.release(folder, files.GATEWAY_LOCK, self._claim)
            raise
        self.endpoints = self._sockets.endpoints
        self._journal = Journal(unix_ns)
        self._view = ServoView(folder, setup.servo, unix_ns)
        self._desk = Desk(self._view, self._journal, self._inquire)
        self._publisher = Publisher(self._view, self._desk.actors, self._journal, setup, unix_ns)
        self._poller = zmq.Poller()
        self._poller.register(self._sockets.command, zmq.POLLIN)
        self._poller.register(self._sockets.telemetry, zmq.POLLIN)
        self._passed_ns = self._settled_ns = self._drained_ns = clock.now_ns()
        if self._sockets.warning:
            self._journal.note("warning", text=self._sockets.warning)

    def step(self, wait_ms: int = DRAIN_MS) -> None:
        """One pass of the loop; waits at most `wait_ms` for something to do."""
        if self._desk.waiting and wait_ms and not self._poller.poll(0):
            self._clock.sleep_until_ns(self._clock.now_ns() + PEEK_NS)
            wait_ms = 0
        ready = dict(self._poller.poll(wait_ms))
        now_ns = self._clock.now_ns()
        self._view.refresh(now_ns)
        if self._view.mailbox:
            # before the requests: whatever they cost, the servo has its heartbeat
            self._view.mailbox.beat(now_ns)
        if now_ns - self._passed_ns > STANDSTILL_NS:
            self._settled_ns = now_ns + SETTLING_NS
        self._passed_ns = now_ns
        requests = (
            _received(self._sockets.command, REQUESTS_PER_PASS)
            if self._sockets.command in ready
            else []
        )
        outdated = now_ns < self._settled_ns
        for reply in self._desk.serve(requests, now_ns, outdated) + self._desk.collect(now_ns):
            self._sockets.command.send_multipart(reply, zmq.DONTWAIT)
        if self._sockets.telemetry in ready:
            self._note_subscriptions()
        # 1 ms of slack: a pass just short of 10 ms must not put it off for another 10
        if now_ns - self._drained_ns >= (DRAIN_MS - 1) * NS_PER_MS:
            self._drained_ns = now_ns
            self._publish(self._publisher.messages(now_ns, self._unix_ns()))

    def _note_subscriptions(self) -> None:
        for message, *_ in _received(self._sockets.telemetry, SUBSCRIPTIONS_PER_PASS):
            self._publish(self._publisher.subscribe(message, self._unix_ns()))

    def _publish(self, messages: list[tuple[str, bytes]]) -> None:
        for topic, payload in messages:
            self._sockets.telemetry.send_multipart([topic.encode(), payload], zmq.DONTWAIT)

    def _inquire(self, cmd: str) -> dict[str, Any]:
        if cmd == "dump":
            return self._publisher.flight.dump("asked")
        return self._hello() if cmd == "hello" else self._status()

    def _hello(self) -> dict[str, Any]:
        servo = self._setup.servo
        return {
            "server": "hapticd",
            "version": hapticd.__version__,
            "protocol": PROTOCOL_VERSION,
            "schema_hash": hashlib.sha256(json.dumps(self._desk.schema).encode()).hexdigest()[:16],
            "layout": LAYOUT_HASH.hex(),
            "instance": servo.instance,
            "simulated": servo.simulated,
            "rate_hz": servo.realtime.rate_hz,
            "endpoints": self.endpoints,
            "topics": [topic._asdict() for topic in TOPICS],
            "servo": to_plain(servo),
        }

    def _status(self) -> dict[str, Any]:
        mailbox = self._view.mailbox
        return {
            **state_map(self._view, self._desk.actors, self._unix_ns()),
            "stages": self._publisher.stages.summary(),
            "endpoints": self.endpoints,
            "servo": mailbox.report() if mailbox else {},
            "gateway": {
                "pid": os.getpid(),
                "cpu_s": time.process_time(),
                "telemetry_lost": self._publisher.feed.lost,
            },
            "events": list(self._journal.recent),
        }

    def close(self) -> None:
        """Close the sockets, give up the claim."""
        self._publisher.flight.close()
        self._sockets.close()
        self._view.drop()
        files.release(self._view.folder, files.GATEWAY_LOCK, self._claim)


def _received(socket: "zmq.Socket[bytes]", most: int) -> list[list[bytes]]:
    """Up to `most` messages that are there already."""
    found: list[list[bytes]] = []
    while len(found) < most:
        try:
            found.append(socket.recv_multipart(zmq.DONTWAIT))
        except zmq.Again:
            break
    return found


def run(
    folder: Path,
    setup: GatewaySetup,
    clock: Clock,
    should_stop: Callable[[], bool],
    on_ready: Callable[[], None] | None = None,
) -> None:
    """Serve until `should_stop()`, asked once a pass (every 10 ms at least).

    MailboxError, ConfigError: it can not begin.
    """
    gateway = GatewayServer(folder, setup, clock)
    try:
        if on_ready:
            on_ready()
        while not should_stop():
            gateway.step()
    finally:
        gateway.close()
