"""The relay: telemetry for other computers, in a process of its own.

    python -m hapticd.gateway.relay KEYS SOURCE ENDPOINT --listener FD --line FD

It subscribes at SOURCE, the gateway's socket file, to what its own listeners ask for, and passes
that on to those who connect to ENDPOINT and prove a key that the folder KEYS knows. CURVE is
libzmq's (RFC 26), which asks here whether a key is known (ZAP, RFC 27) and refuses everybody when
nobody answers. The gateway keeps the other end of the line FD: it hears who was refused and how
many are there, and when it closes the line this process ends.

It is a process because libzmq bounds neither the connections nor the memory that somebody outside
can have it take, and ends a process rather than go on without (ADR-0020). The kernel bounds
both, for this process alone: MOST_DESCRIPTORS, MOST_MEMORY; it yields to the gateway by NICENESS,
and the gateway starts it anew when it ends.

What goes inwards is a subscription and nothing else: one part, LONGEST_SUBSCRIPTION bytes.

It must import only what it needs (memory), and wait in the poll alone.
"""

import argparse
import os
import resource
import socket
import sys
import time
from collections import Counter
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import msgpack
import zmq
from zmq.utils import z85

from hapticd.core.errors import HapticdError
from hapticd.core.units import NS_PER_MS
from hapticd.gateway.peers import HANDSHAKE_NS, MOST_PEERS, PROBE_S, SILENCE_S
from hapticd.guard.worker import LENGTH
from hapticd.protocol import zmq_monitor
from hapticd.protocol.keys import Clients, server_pair

MOST_DESCRIPTORS = MOST_PEERS + 32  # connections, and what the process itself needs
MOST_MEMORY = 256 << 20  # bytes of data; at rest it has some 60 MB, threads' stacks included
NICENESS = 10
RELAYED_QUEUED = 100  # messages per listener: 2 s
LONGEST_RELAYED = 1 << 22  # bytes of a part of a message
LONGEST_SUBSCRIPTION = 1024
AT_ONCE = 100  # messages of one socket before the others have their turn
LOOK_MS = 500
NEWS_S = 5.0  # between two reports of refusals, which come as often as somebody likes
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
    """Who is connected from where, and who was refused, by the events of libzmq's monitor.

    A failed handshake is told without an address; the end of its connection comes next, by its
    descriptor, whose address was noted when it began. One that ended before that has none.
    """

    def __init__(self) -> None:
        self._addresses: dict[int, str] = {}
        self._failed = ""  # why the connection fails that ends next
        self.refused: Counter[tuple[str, str]] = Counter()  # (address, why) since the last report
        self.total = 0  # refusals

    @property
    def connected(self) -> int:
        """How many connections there are, in their handshake or after it."""
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
    """The address of the other end; empty where the connection has ended meanwhile, also if its
    number is another socket's by now.
    """
    try:
        with socket.socket(fileno=os.dup(descriptor)) as connection:
            network = connection.family in (socket.AF_INET, socket.AF_INET6)
            return str(connection.getpeername()[0]) if network else ""
    except (OSError, IndexError):
        return ""


class Relay:
    """Sockets of the relay; `tell` takes a report for the gateway.

    ConfigError: the keys are incomplete, or the server's is readable by others.
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
            # never held back, and no heartbeats: a peer that dies while its input is held back
            # makes libzmq abort: https://github.com/zeromq/libzmq/issues/4364
            zmq.RCVHWM: 0,
        }
        for option, value in options.items():
            relayed.setsockopt(option, value)
        return relayed

    def _guard_offer(self) -> None:
        """Demand CURVE and a known key of whoever connects."""
        self._offer.curve_publickey, self._offer.curve_secretkey = server_pair(self._keys)
        self._offer.curve_server = True
        self._offer.zap_domain = b"hapticd"
        # without it libzmq lets everybody in when nobody answers for the keys
        self._offer.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)
        # every subscription is passed on, not the first alone: late joiners get `state`
        self._offer.setsockopt(zmq.XPUB_VERBOSE, 1)

    def run(self, line: socket.socket) -> None:
        """Pass on until the gateway closes `line`."""
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
        """Answer whether a key is known."""
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
        self._connections.take(*zmq_monitor.take(self._monitor))

    def _report(self) -> None:
        """Tell the gateway what changed, and once that all is well: counts at most every LOOK_MS,
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
    """Attend to what has come, to AT_ONCE messages at most."""
    for _ in range(AT_ONCE):
        try:
            attend()
        except zmq.Again:
            return


def main(arguments: list[str]) -> int:
    """Relay until the other end of the line closes; the exit code."""
    parser = argparse.ArgumentParser(prog="relay", allow_abbrev=False)
    parser.add_argument("keys", type=Path)
    parser.add_argument("source")
    parser.add_argument("endpoint")
    parser.add_argument("--listener", type=int, required=True)
    parser.add_argument("--line", type=int, required=True)
    asked = parser.parse_args(arguments)
    _limit()
    line = socket.socket(fileno=asked.line)
    line.settimeout(1.0)  # a gateway that takes no report for so long passes on nothing either

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
    os._exit(0)  # what its threads still hold for listeners is nothing that is waited for


def _limit() -> None:
    """What whoever is outside can have this process take."""
    resource.setrlimit(resource.RLIMIT_NOFILE, (MOST_DESCRIPTORS, MOST_DESCRIPTORS))
    resource.setrlimit(resource.RLIMIT_DATA, (MOST_MEMORY, MOST_MEMORY))
    os.nice(NICENESS)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
