"""The relay: telemetry for other computers, in a separate process.

    python -m hapticd.gateway.relay KEYS SOURCE ENDPOINT --listener FD --line FD

It subscribes at SOURCE, the gateway's socket file, to the topics that its own subscribers want. It
forwards them to the clients that connect to ENDPOINT and prove a key in the folder KEYS. libzmq
implements CURVE (RFC 26). It queries this process for each key (ZAP, RFC 27), and refuses every
client without an answer. The gateway keeps the other end of the line FD. It receives the refusals
and the number of connections, and this process ends when the gateway closes the line.

A separate process is needed because libzmq limits neither the connections nor the memory that a
remote host can use. It aborts the process when they run out (ADR-0020). The kernel limits both for
this process alone: MOST_DESCRIPTORS, MOST_MEMORY. It yields to the gateway by NICENESS, and the
gateway restarts it when it ends.

Only subscriptions pass inwards: one part, LONGEST_SUBSCRIPTION bytes.

The gateway starts and restarts it, and reports refusals (`RelaySupervisor`). The listening socket
stays in the gateway: connections made without a relay wait for the next one, and the port stays the
same. Line and process are those of `guard.worker`, with another program.

The relay must import only the necessary modules (memory), and wait only in the poll.
"""

import argparse
import os
import resource
import selectors
import socket
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgpack
import zmq
from zmq.utils import z85

from hapticd.core.errors import HapticdError
from hapticd.core.process import launch
from hapticd.core.units import NS_PER_MS
from hapticd.gateway.peers import HANDSHAKE_NS, MOST_PEERS, PROBE_S, SILENCE_S
from hapticd.guard.worker import LENGTH, Worker
from hapticd.protocol.journal import EventCode
from hapticd.protocol.keys import Clients, server_pair, take

if TYPE_CHECKING:
    import subprocess

MOST_DESCRIPTORS = MOST_PEERS + 32  # connections, and those of the process itself
MOST_MEMORY = 256 << 20  # bytes of data; about 60 MB at rest, with the stacks of threads
NICENESS = 10
RELAYED_QUEUED = 100  # messages per subscriber: 2 s
LONGEST_RELAYED = 1 << 22  # bytes of a part of a message
LONGEST_SUBSCRIPTION = 1024
AT_ONCE = 100  # messages of one socket before the others have their turn
LOOK_MS = 500
NEWS_S = 5.0  # between two reports of refusals, whose rate a remote host determines
MOST_REASONS = 16  # in one report
EVENTS = (
    zmq.EVENT_ACCEPTED
    | zmq.EVENT_DISCONNECTED
    | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL
    | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
)
REASONS: dict[int, str] = {
    zmq.PROTOCOL_ERROR_ZMTP_MECHANISM_MISMATCH: "it offers no key",
    zmq.PROTOCOL_ERROR_ZMTP_CRYPTOGRAPHIC: "it has another server's key",
}


class Connections:
    """Connected addresses and refusals, from the events of libzmq's monitor.

    The event of a failed handshake has no address. The end of its connection follows, with the
    descriptor, whose address was noted at the start. A connection that ended before that has none.
    """

    def __init__(self) -> None:
        self._addresses: dict[int, str] = {}
        self._failed = ""  # why the next connection to end has failed
        self.refused: Counter[tuple[str, str]] = Counter()  # (address, why) since the last report
        self.total = 0  # refusals

    @property
    def connected(self) -> int:
        """Number of connections, during or after their handshake."""
        return len(self._addresses)

    def take(self, event: int, value: int) -> None:
        """Note one event."""
        if event == zmq.EVENT_ACCEPTED:
            self._addresses[value] = address_of(value)
        elif event == zmq.EVENT_DISCONNECTED:
            address = self._addresses.pop(value, "")
            if self._failed:
                self.refuse(address, self._failed)
            self._failed = ""
        elif event == zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL:
            self._failed = REASONS.get(value, "it breaks the protocol")
        else:
            self._failed = "it ended, or was silent, before it had shown a key"

    def refuse(self, address: str, why: str) -> None:
        """Count a refusal."""
        self.total += 1
        known = (address, why) in self.refused or len(self.refused) < MOST_REASONS
        self.refused[(address, why) if known else ("", "others")] += 1


def address_of(descriptor: int) -> str:
    """Return the address of the other end; empty if the connection has ended, or if its descriptor
    now belongs to another socket.
    """
    try:
        with socket.socket(fileno=os.dup(descriptor)) as connection:
            network = connection.family in (socket.AF_INET, socket.AF_INET6)
            return str(connection.getpeername()[0]) if network else ""
    except (OSError, IndexError):
        return ""


class Relay:
    """Sockets of the relay; `tell` sends a report to the gateway.

    ConfigError: the keys are incomplete, or the server's key is readable by others.
    """

    def __init__(
        self,
        keys: Path,
        source: str,
        listener: int,
        endpoint: str,
        tell: Callable[[dict[str, Any]], None],
    ) -> None:
        self._keys = keys
        self._tell = tell
        self._clients = Clients(keys)
        self._connections = Connections()
        self._reported: tuple[int, int, dict[str, str]] | None = None
        self._report_s = 0.0
        self._news_s = 0.0
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._zap = self._context.socket(zmq.REP)
        self._zap.bind("inproc://zeromq.zap.01")  # the place that RFC 27 names
        self._source = self._socket(zmq.XSUB, LONGEST_RELAYED)
        self._offer = self._socket(zmq.XPUB, LONGEST_SUBSCRIPTION)
        self._monitor = self._offer.get_monitor_socket(EVENTS)
        self._guard_offer()
        self._offer.setsockopt(zmq.USE_FD, listener)
        self._offer.bind(endpoint)
        self._source.connect(source)

    def _socket(self, kind: int, longest: int) -> "zmq.Socket[bytes]":
        relayed = self._context.socket(kind)
        options = {
            zmq.LINGER: 0,
            zmq.MAXMSGSIZE: longest,
            zmq.SNDHWM: RELAYED_QUEUED,
            zmq.HANDSHAKE_IVL: HANDSHAKE_NS // NS_PER_MS,
            zmq.TCP_KEEPALIVE: 1,
            zmq.TCP_KEEPALIVE_IDLE: PROBE_S,
            zmq.TCP_KEEPALIVE_INTVL: PROBE_S,
            zmq.TCP_KEEPALIVE_CNT: SILENCE_S // PROBE_S,
            # no input limit and no heartbeats: libzmq aborts if a peer dies while its input is
            # held back: https://github.com/zeromq/libzmq/issues/4364
            zmq.RCVHWM: 0,
        }
        for option, value in options.items():
            relayed.setsockopt(option, value)
        return relayed

    def _guard_offer(self) -> None:
        """Require CURVE and a known key from every client."""
        self._offer.curve_publickey, self._offer.curve_secretkey = server_pair(self._keys)
        self._offer.curve_server = True
        self._offer.zap_domain = b"hapticd"
        # without it libzmq accepts every client if ZAP does not answer
        self._offer.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)
        # forward every subscription, not only the first: late subscribers get `state`
        self._offer.setsockopt(zmq.XPUB_VERBOSE, 1)

    def run(self, line: socket.socket) -> None:
        """Forward messages until the gateway closes `line`."""
        attend = {
            self._source: self._pass_outwards,
            self._offer: self._pass_inwards,
            self._zap: self._judge,
            self._monitor: self._note,
        }
        poller = zmq.Poller()
        for one in (*attend, line.fileno()):
            poller.register(one, zmq.POLLIN)
        while True:
            for one, _ in poller.poll(LOOK_MS):
                if one == line.fileno():
                    return
                _some(attend[one])
            self._report()

    def _pass_outwards(self) -> None:
        self._offer.send_multipart(self._source.recv_multipart(zmq.NOBLOCK), zmq.NOBLOCK)

    def _pass_inwards(self) -> None:
        message, *more = self._offer.recv_multipart(zmq.NOBLOCK)
        if not more and message[:1] in (b"\0", b"\1"):
            self._source.send(message, zmq.NOBLOCK)

    def _judge(self) -> None:
        asked = self._zap.recv_multipart(zmq.NOBLOCK)
        _version, number, _domain, address, _identity, mechanism, *credentials = asked
        key = z85.encode(credentials[0]) if mechanism == b"CURVE" and credentials else b""
        name = self._clients.name(key)
        if not name:
            self._connections.refuse(address.decode(), f"its key {key.decode()} is not known")
        self._zap.send_multipart(
            [b"1.0", number, b"200" if name else b"400", b"", name.encode(), b""]
        )

    def _note(self) -> None:
        self._connections.take(*take(self._monitor))

    def _report(self) -> None:
        """Report changes to the gateway, and one first report: counts at most every LOOK_MS,
        refusals every NEWS_S.
        """
        at_s = time.monotonic()
        if at_s < self._report_s:
            return
        self._report_s = at_s + 1e-3 * LOOK_MS
        self._clients.look()
        unreadable = dict(islice(self._clients.unreadable.items(), MOST_REASONS))
        found = (self._connections.connected, self._connections.total, unreadable)
        refused = self._connections.refused if at_s >= self._news_s else Counter()
        if not refused and found == self._reported:
            return
        news = [[address, why, times] for (address, why), times in refused.items()]
        if news:
            self._news_s = at_s + NEWS_S
            refused.clear()
        self._reported = found
        connected, total, _ = found
        self._tell(
            {"connected": connected, "refused": total, "unreadable": unreadable, "news": news}
        )


def _some(attend: Callable[[], None]) -> None:
    for _ in range(AT_ONCE):
        try:
            attend()
        except zmq.Again:
            return


def main(arguments: list[str]) -> int:
    """Relay until the other end of the line closes; return the exit code."""
    parser = argparse.ArgumentParser(prog="relay", allow_abbrev=False)
    parser.add_argument("keys", type=Path)
    parser.add_argument("source")
    parser.add_argument("endpoint")
    parser.add_argument("--listener", type=int, required=True)
    parser.add_argument("--line", type=int, required=True)
    asked = parser.parse_args(arguments)
    _limit()
    line = socket.socket(fileno=asked.line)
    line.settimeout(1.0)  # a gateway that reads no report for 1 s sends no telemetry either

    def tell(report: dict[str, Any]) -> None:
        data = bytes(msgpack.packb(report))
        line.sendall(LENGTH.pack(len(data)) + data)

    tell({"hello": {"config_hash": "", "pid": os.getpid()}})
    try:
        relay = Relay(asked.keys, asked.source, asked.listener, asked.endpoint, tell)
    except HapticdError as error:
        tell({"ended": str(error)})
        return error.exit_code
    relay.run(line)
    os._exit(0)  # do not wait for messages still queued in libzmq's threads


def _limit() -> None:
    """Limit the resources that remote hosts can make this process use."""
    resource.setrlimit(resource.RLIMIT_NOFILE, (MOST_DESCRIPTORS, MOST_DESCRIPTORS))
    resource.setrlimit(resource.RLIMIT_DATA, (MOST_MEMORY, MOST_MEMORY))
    os.nice(NICENESS)


# --- the gateway's side ---------------------------------------------------------------------------
MODULE = "hapticd.gateway.relay"

Events = Iterator[tuple[EventCode, dict[str, Any]]]  # with their fields


class RelaySupervisor:
    """Telemetry of the endpoint `source`, offered by `listener` at `endpoint`, to clients with a
    key in the folder `keys`.

    ConfigError: the keys are incomplete, or the server's key is readable by others.
    """

    def __init__(
        self,
        source: str,
        listener: socket.socket,
        endpoint: str,
        keys: Path,
        selector: selectors.BaseSelector,
    ) -> None:
        self._listener = listener
        self._command = [str(keys), source, endpoint]
        try:
            server_pair(keys)
        except BaseException:
            listener.close()
            raise
        self._relay = Worker(self._start, selector, "")
        self._process: subprocess.Popen[bytes] | None = None
        self._seen: dict[str, Any] = {"connected": 0, "refused": 0, "unreadable": {}}
        self._trouble = ""  # the last reported one

    def _start(self, line: socket.socket) -> "subprocess.Popen[bytes]":
        passed = (line.fileno(), self._listener.fileno())
        ends = ("--line", str(passed[0]), "--listener", str(passed[1]))
        self._process = launch(MODULE, *self._command, *ends, keep=passed)
        return self._process

    def tend(self, now_ns: int) -> Events:
        """Start the relay if due; yield warnings about refused clients, unreadable keys and the end
        of the relay.
        """
        self._relay.tend(now_ns)
        for report in self._relay.answers():
            if "ended" in report:
                yield from self._ended(report["ended"])
            else:
                yield from self._took(report)
        code = self._process.poll() if self._process and self._relay.state == "down" else None
        if code is not None and not self._trouble:
            yield from self._ended(f"the relay ended, exit code {code}")

    def _took(self, report: dict[str, Any]) -> Events:
        """Yield the warnings in a report of a running relay."""
        self._trouble = ""
        known = self._seen["unreadable"]
        self._seen = {name: report[name] for name in self._seen}
        for name, why in self._seen["unreadable"].items():
            if known.get(name) != why:
                yield "key_unreadable", {"path": name, "reason": why}
        for address, why, times in report["news"]:
            often = {"times": times} if times > 1 else {}
            yield "listener_refused", {"address": address, "reason": why, **often}

    def _ended(self, why: str) -> Events:
        """Yield a warning that the relay has ended, once for each reason; it is restarted."""
        if why != self._trouble:
            self._trouble = why
            yield "relay_ended", {"reason": why}

    def summary(self) -> dict[str, Any]:
        """Return the part of `status` about the relay. It has the state of the relay, its trouble,
        its process, connections, refusals so far and unreadable key files.
        """
        pid = self._process.pid if self._process else None
        state = {"relay": self._relay.state, "trouble": self._trouble, "pid": pid}
        return state | self._seen

    def close(self) -> None:
        """End the relay."""
        self._relay.close()
        if self._process:
            self._process.wait()  # it was killed
        self._listener.close()


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
