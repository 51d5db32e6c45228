"""The gateway process: its event loop and its sockets.

Loop (`GatewayServer`). A client that stops reading fills its own queue and loses messages; one that
sends too much at once is disconnected, or read later; one that dies is forgotten (`peers`).

One pass of the loop writes the heartbeat, reads the sockets, serves up to 20 requests (stops
first), sends due replies and notes subscriptions. Every 10 ms it publishes the content of the ring.
Requests and subscriptions share a budget of PASS_NS; the rest waits for the next pass. The
heartbeat is written between any two of them. A pass waits for a socket at most 10 ms; while answers
of the servo are outstanding it polls again after 0.25 ms. A change of a lamp of the page (state,
fault or the reported damping) is published at once. For 5 ms after a receipt the loop checks for
one every millisecond. Sends never block.

No request or publication may take longer than the servo's timeout of the heartbeat (1 s). A folder
has one gateway: the claim is taken before any socket is bound.

Sockets (`Sockets`). There are two socket files in the runtime folder, and one TCP port:

    ROUTER  ipc://<runtime folder>/command     requests and replies
    XPUB    ipc://<runtime folder>/telemetry   topics, for this machine
            tcp://127.0.0.1:9872               the same, at the default address of PlotJuggler

The socket files are accessible to user and group only; the folder may restrict access further. Only
the default instance claims port 9872; if it is in use, any free port is used. With keys the relay
(`relay`), the only part with CURVE, serves the port.
"""

import errno
import hashlib
import json
import os
import selectors
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hapticd
from hapticd.core.errors import ConfigError, MailboxError
from hapticd.core.params import GatewayParams, GatewaySetup, to_plain
from hapticd.core.units import NS_PER_MS, NS_PER_S, NS_PER_US, Clock
from hapticd.gateway import peers
from hapticd.gateway.command_server import CommandServer
from hapticd.gateway.publisher import Publisher
from hapticd.guard.status import Guard
from hapticd.guard.worker import Start, Worker
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
from hapticd.protocol import leases
from hapticd.protocol.codec import MAX_MESSAGE_BYTES
from hapticd.protocol.journal import EventCode, Journal, sentence
from hapticd.protocol.schemas import PROTOCOL_VERSION
from hapticd.protocol.telemetry import TOPICS
from hapticd.protocol.view import ServoView

if TYPE_CHECKING:
    from hapticd.gateway.relay import RelaySupervisor

__all__ = ["run"]

# --- sockets --------------------------------------------------------------------------------------
# Linux reserves 108 bytes, the last of which is 0
LONGEST_PATH = 107  # of a socket file
REPLIES_QUEUED = 200
MESSAGES_QUEUED = 100  # per subscriber: 2 s
MAX_SUBSCRIPTION_BYTES = 1024
# `bind` creates the socket file; this mask leaves read and write access for user and group
SOCKET_UMASK = 0o117


class Sockets:
    """Both kinds of socket, bound, watched by `selector`.

    `endpoints` is {command, telemetry: [..], pid}; `warnings` are events with their fields;
    `left` and `gone` are called with the identity of a command client or a subscriber whose
    connection has ended.
    """

    def __init__(
        self,
        folder: Path,
        setup: GatewaySetup,
        selector: selectors.BaseSelector,
        left: Callable[[bytes], None],
        gone: Callable[[bytes], None],
    ) -> None:
        self._folder = folder
        self._selector = selector
        params = setup.gateway
        self.warnings: list[tuple[EventCode, dict[str, Any]]] = []
        if leases.in_the_clear(params):
            self.warnings.append(("telemetry_open", {"address": params.tcp_host}))
        self.command = peers.Port(b"ROUTER", MAX_MESSAGE_BYTES, REPLIES_QUEUED, selector, left)
        self.telemetry = peers.Port(
            b"XPUB", MAX_SUBSCRIPTION_BYTES, MESSAGES_QUEUED, selector, gone
        )
        self.relay: RelaySupervisor | None = None
        try:
            self.endpoints = self._bound(params, setup.servo.instance)
        except BaseException:
            self.close()
            raise

    def _bound(self, params: GatewayParams, instance: str) -> dict[str, object]:
        before = os.umask(SOCKET_UMASK)
        try:
            command = listen_at(self.command, self._folder / COMMAND_SOCKET)
            telemetry = listen_at(self.telemetry, self._folder / TELEMETRY_SOCKET)
        finally:
            os.umask(before)
        port = port_for(params, instance)
        listener = bound_tcp(params.tcp_host, port)
        tcp = endpoint_of(listener)
        if leases.needs_keys(params):
            self.relay = self._guarded(telemetry, listener, tcp, params)
        else:
            self.telemetry.listen(listener)
        endpoints = {"command": command, "telemetry": [telemetry, tcp], "pid": os.getpid()}
        if port and listener.getsockname()[1] != port:
            taken = {"port": port, "address": tcp}
            self.warnings.append(("port_taken", taken))
            endpoints["elsewhere"] = sentence("port_taken", **taken)
        # last: this file announces that clients can connect
        write_whole(self._folder / ENDPOINTS, json.dumps(endpoints))
        return endpoints

    def _guarded(
        self, source: str, listener: socket.socket, endpoint: str, params: GatewayParams
    ) -> "RelaySupervisor":
        from hapticd.gateway.relay import RelaySupervisor  # libzmq, for it alone

        return RelaySupervisor(
            source, listener, endpoint, Path(params.curve_keys or ""), self._selector
        )

    def tend(self, now_ns: int) -> Iterator[tuple[EventCode, dict[str, Any]]]:
        """End connections that are due to end; yield warnings about refused connections."""
        self.command.tend(now_ns)
        self.telemetry.tend(now_ns)
        if self.relay:
            yield from self.relay.tend(now_ns)

    def close(self) -> None:
        """Close all sockets and remove their files."""
        if self.relay:
            self.relay.close()
        self.command.close()
        self.telemetry.close()
        remove(self._folder, ENDPOINTS, COMMAND_SOCKET, TELEMETRY_SOCKET)


def listen_at(port: peers.Port, path: Path) -> str:
    """Let `port` listen at a socket file; return its endpoint.

    ConfigError: the path is too long for a socket. MailboxError: the file cannot be created.
    """
    if len(os.fsencode(path)) > LONGEST_PATH:
        raise ConfigError(
            f"{path}: {len(os.fsencode(path))} bytes, a socket file has at most {LONGEST_PATH}; use"
            " a shorter folder"
        )
    listener = socket.socket(socket.AF_UNIX)
    try:
        path.unlink(missing_ok=True)
        listener.bind(os.fspath(path))
    except OSError as error:
        listener.close()
        raise MailboxError(
            f"{path}: {error.strerror}; free some space, correct its permissions"
            " or remove the obstacle"
        ) from error
    port.listen(listener)
    return f"ipc://{path}"


def port_for(params: GatewayParams, instance: str) -> int:
    """Return the port to try first; 0 (any free one) for instances other than the default one."""
    usual = params.telemetry_port == GatewayParams().telemetry_port
    return 0 if usual and instance != DEFAULT_INSTANCE else params.telemetry_port


def bound_tcp(host: str, port: int) -> socket.socket:
    """Return a socket that listens at `port` of `host`, or at any free port if that is in use.

    ConfigError: the address does not belong to this machine.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        return socket.create_server(address[:2], family=family)
    except OSError as error:
        if error.errno != errno.EADDRINUSE or port == 0:
            raise ConfigError(
                f"gateway.tcp_host = {host!r}: {error.strerror}; name an address of this machine"
            ) from error
        return bound_tcp(host, 0)


def endpoint_of(listener: socket.socket) -> str:
    """Return the endpoint of a TCP socket in the notation of ZeroMQ."""
    host, port, *_ = listener.getsockname()
    # ZeroMQ wants brackets around an IPv6 address
    return f"tcp://[{host}]:{port}" if ":" in host else f"tcp://{host}:{port}"


# --- the loop -------------------------------------------------------------------------------------
DRAIN_MS = 10
PEEK_NS = 250 * NS_PER_US  # between polls for an outstanding answer
WATCHFUL_MS = 1  # instead of 10, after a receipt: the board reports one or two ticks later
WATCHFUL_NS = 5 * NS_PER_MS
REQUESTS_PER_PASS = 20
SUBSCRIPTIONS_PER_PASS = 100
PASS_NS = 20 * NS_PER_MS  # for requests and subscriptions; the current one is completed
STANDSTILL_NS = NS_PER_S  # after a longer pause the senders of waiting requests have given up
SETTLING_NS = 100 * NS_PER_MS  # until all of them are read


class GatewayServer:
    """One gateway in one runtime folder.

    MailboxError: another gateway is running; ConfigError: an address or key is invalid.
    """

    def __init__(
        self,
        folder: Path,
        setup: GatewaySetup,
        clock: Clock,
        unix_ns: Callable[[], int] = time.time_ns,
        start_worker: Start | None = None,
    ) -> None:
        self._setup = setup
        self._clock = clock
        self._unix_ns = unix_ns
        with ExitStack() as opened:
            self._open(folder, start_worker, opened)
            self._opened = opened.pop_all()
        self._passed_ns = self._settled_ns = self._drained_ns = clock.now_ns()
        self._deadline_ns = 0
        self._watchful_ns = clock.now_ns()
        for code, fields in self._sockets.warnings:
            self._journal.note(code, **fields)

    def _open(self, folder: Path, start_worker: Start | None, opened: ExitStack) -> None:
        """Claim the folder and create all parts; `opened` closes them in reverse order."""
        setup = self._setup
        claim = files.claim(files.prepare_folder(folder), files.GATEWAY_LOCK)
        opened.callback(files.release, folder, files.GATEWAY_LOCK, claim)
        self._selector = opened.enter_context(selectors.DefaultSelector())
        self._journal = Journal(self._unix_ns)
        self._view = ServoView(folder, setup.servo, self._unix_ns)
        opened.callback(self._view.drop)
        worker = start_worker and Worker(start_worker, self._selector, setup.servo.config_hash)
        self._guard = Guard(self._view, self._journal, setup.guard, worker)
        opened.callback(self._guard.close)
        self._commands = CommandServer(
            self._view, self._journal, self._inquire, self._guard, setup.lease
        )
        self._publisher = Publisher(
            self._view,
            self._commands.actors,
            self._journal,
            setup,
            self._guard,
            self._unix_ns,
            self._commands.leases,
        )
        opened.callback(self._publisher.flight.close)
        self._sockets = Sockets(
            folder, setup, self._selector, self._commands.leave, self._publisher.leave
        )
        opened.callback(self._sockets.close)
        self.endpoints = self._sockets.endpoints

    @property
    def foreign(self) -> str:
        """Hash of a servo's configuration that differs from this gateway's; empty if none does."""
        return self._view.foreign

    def step(self, wait_ms: int = DRAIN_MS) -> None:
        """Run one pass of the loop; wait at most `wait_ms` for input."""
        self._await(wait_ms)
        now_ns = self._clock.now_ns()
        self._deadline_ns = now_ns + PASS_NS
        if self._view.ended:  # its last records show whether it ended without force
            self._view.look()
            self._publish(self._publisher.messages(now_ns, self._unix_ns(), ended=True))
        self._view.refresh(now_ns)
        if now_ns - self._passed_ns > STANDSTILL_NS:
            self._settled_ns = now_ns + SETTLING_NS
        self._passed_ns = now_ns
        # before the requests: the heartbeat does not depend on their duration
        self._in_time()
        for code, fields in self._sockets.tend(now_ns):
            self._journal.note(code, **fields)
        self._serve(now_ns)
        self._note_subscriptions()
        # 1 ms of slack: a pass just short of 10 ms must not delay it by another 10 ms
        due = now_ns - self._drained_ns >= (DRAIN_MS - 1) * NS_PER_MS
        if due or self._publisher.urgent(now_ns):
            self._drained_ns = now_ns
            self._publish(self._publisher.messages(now_ns, self._unix_ns()))
            self._in_time()

    def _await(self, wait_ms: int) -> None:
        sockets = self._sockets
        if sockets.command.busy or sockets.telemetry.busy or self._commands.queued:
            wait_ms = 0
        elif self._commands.waiting and wait_ms and not self._selector.select(0):
            self._clock.sleep_until_ns(self._clock.now_ns() + PEEK_NS)
            wait_ms = 0
        if self._clock.now_ns() < self._watchful_ns:
            wait_ms = min(wait_ms, WATCHFUL_MS)
        for key, mask in self._selector.select(wait_ms / 1000):
            key.data(mask)

    def _in_time(self) -> bool:
        """Write the heartbeat; return whether this pass has time for more."""
        now_ns = self._clock.now_ns()
        if self._view.mailbox:
            self._view.mailbox.beat(now_ns)
        return now_ns < self._deadline_ns

    def _serve(self, now_ns: int) -> None:
        requests = self._sockets.command.receive(REQUESTS_PER_PASS)
        came = [[identity, *parts] for identity, parts in requests]
        replies = self._commands.serve(came, now_ns, now_ns < self._settled_ns, self._in_time)
        if receipts := self._commands.collect(now_ns):
            self._watchful_ns = now_ns + WATCHFUL_NS
        for identity, *parts in replies + receipts:
            self._sockets.command.send(identity, peers.message(parts))

    def _note_subscriptions(self) -> None:
        for _ in range(SUBSCRIPTIONS_PER_PASS):
            if not (self._sockets.telemetry.busy and self._in_time()):
                break
            for identity, (message, *more) in self._sockets.telemetry.receive(1):
                messages = (
                    [] if more else self._publisher.subscribe(identity, message, self._unix_ns())
                )
                for topic, payload in messages:
                    self._sockets.telemetry.send(identity, _telemetry(topic, payload))

    def _publish(self, messages: list[tuple[str, bytes]]) -> None:
        for topic, payload in messages:
            data = _telemetry(topic, payload)
            for identity in self._publisher.listeners(topic):
                self._sockets.telemetry.send(identity, data)

    def _inquire(self, cmd: str) -> dict[str, Any]:
        dump = self._publisher.flight.dump_asked
        return {"hello": self._hello, "status": self._status, "dump": dump}[cmd]()

    def _hello(self) -> dict[str, Any]:
        servo = self._setup.servo
        return {
            "server": "hapticd",
            "version": hapticd.__version__,
            "protocol": PROTOCOL_VERSION,
            "schema_hash": hashlib.sha256(json.dumps(self._commands.schema).encode()).hexdigest()[
                :16
            ],
            "layout": LAYOUT_HASH.hex(),
            "instance": servo.instance,
            "simulated": servo.simulated,
            "rate_hz": servo.realtime.rate_hz,
            "endpoints": self.endpoints,
            "topics": [topic._asdict() for topic in TOPICS],
            "servo": to_plain(servo),
        }

    def _status(self) -> dict[str, Any]:
        relay = self._sockets.relay
        times = self._publisher.times
        return {
            **self._publisher.without_guard(self._unix_ns()),
            "stages": times.stages(),
            "late": times.late(),
            "room": asdict(times.room),
            "endpoints": self.endpoints,
            "servo": self._view.report(),
            "gateway": {
                "pid": os.getpid(),
                "cpu_s": time.process_time(),
                "telemetry_lost": self._publisher.feed.lost,
                "outside": relay.summary() if relay else None,
            },
            "guard": self._commands.guard_summary(),
            "events": list(self._journal.recent),
        }

    def close(self) -> None:
        """Close the sockets and release the claim."""
        self._opened.close()


def _telemetry(topic: str, payload: bytes) -> bytes:
    return peers.message((topic.encode(), payload))


def run(
    folder: Path,
    read: Callable[[], GatewaySetup],
    clock: Clock,
    should_stop: Callable[[], bool],
    on_ready: Callable[[], None] = lambda: None,
    start_worker: Start | None = None,
) -> None:
    """Serve until `should_stop()`, which is called every pass (at least every 10 ms).

    `read()` returns the configuration, at the start and again when the servo has started with
    another one. `start_worker` starts the guard's worker.

    MailboxError, ConfigError: it cannot start.
    """
    setup: GatewaySetup | None = read()
    while setup is not None:
        gateway = GatewayServer(folder, setup, clock, start_worker=start_worker)
        try:
            on_ready()
            setup = None
            while setup is None and not should_stop():
                gateway.step()
                setup = _renewed(gateway, read)
        finally:
            gateway.close()


def _renewed(gateway: GatewayServer, read: Callable[[], GatewaySetup]) -> GatewaySetup | None:
    """Return the configuration of a servo that differs from `gateway`'s, if it can be read."""
    if not gateway.foreign:
        return None
    try:
        setup = read()
    except ConfigError:
        return None  # it is being written
    return setup if setup.servo.config_hash == gateway.foreign else None
