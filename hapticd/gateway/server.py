"""The gateway process: its sockets, its one loop.

One pass: tell the servo that the gateway lives, take at most 20 requests (stops first), give the replies that are due, note
subscriptions, and every 10 ms publish what the ring holds. A pass waits for a socket at most 10 ms; while answers of the
servo are outstanding it looks again after 0.25 ms. Sends never wait: ZeroMQ drops for whoever does not read.
What would break it: a pass that takes longer than the servo's patience with the heartbeat (1 s), or a second gateway in the
folder (the claim is taken before anything is bound).
"""

import hashlib
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zmq

import hapticd
from hapticd.clock import Clock
from hapticd.gateway.desk import Desk
from hapticd.gateway.events import Journal
from hapticd.gateway.publisher import Publisher
from hapticd.gateway.schemas import PROTOCOL_VERSION
from hapticd.gateway.sockets import Sockets
from hapticd.gateway.state import state_map
from hapticd.gateway.topics import TOPICS
from hapticd.gateway.view import ServoView
from hapticd.mailbox import files
from hapticd.mailbox.layout import LAYOUT_HASH
from hapticd.params import GatewaySetup, to_plain
from hapticd.units import NS_PER_MS, NS_PER_S, NS_PER_US

DRAIN_MS = 10
PEEK_NS = 250 * NS_PER_US  # between looks for an outstanding answer
REQUESTS_PER_PASS = 20
SUBSCRIPTIONS_PER_PASS = 100
STANDSTILL_NS = NS_PER_S  # a pass that comes so late finds requests whose senders have given up
SETTLING_NS = 100 * NS_PER_MS  # until ZeroMQ's own thread has handed over all of them


class Gateway:
    """One gateway in one runtime folder. MailboxError: another one is there; ConfigError: an address or key is wrong."""

    def __init__(self, folder: Path, setup: GatewaySetup, clock: Clock, unix_ns: Callable[[], int] = time.time_ns) -> None:
        self._setup, self._clock, self._unix_ns = setup, clock, unix_ns
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
            self._view.mailbox.beat(now_ns)
        if now_ns - self._passed_ns > STANDSTILL_NS:
            self._settled_ns = now_ns + SETTLING_NS
        self._passed_ns = now_ns
        requests = _received(self._sockets.command, REQUESTS_PER_PASS) if self._sockets.command in ready else []
        outdated = now_ns < self._settled_ns
        for reply in self._desk.serve(requests, now_ns, outdated) + self._desk.collect(now_ns):
            self._sockets.command.send_multipart(reply, zmq.DONTWAIT)
        if self._sockets.telemetry in ready:
            self._note_subscriptions()
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
            "gateway": {"pid": os.getpid(), "cpu_s": time.process_time(), "telemetry_lost": self._publisher.feed.lost},
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
    """Serve until `should_stop()`, asked once a pass (every 10 ms at least). MailboxError, ConfigError: it can not begin."""
    gateway = Gateway(folder, setup, clock)
    try:
        if on_ready:
            on_ready()
        while not should_stop():
            gateway.step()
    finally:
        gateway.close()
