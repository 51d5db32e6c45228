"""Peers of a running gateway that behave as no library allows; each is a separate process.

    python -m attacks.peers KIND FOLDER PIECES SEED

They speak ZMTP by hand on plain sockets. When a connection ends, or the kernel accepts no data, a
peer continues on a new connection, until PIECES are done. A piece is done if the gateway greeted
the connection, or if the kernel accepted the whole piece on such a connection. All others count as
refused. Prints both numbers; ends with an error if no piece is accepted for GIVEN_UP_S.
"""

import os
import signal
import socket
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from itertools import accumulate
from pathlib import Path
from random import Random
from select import select

import msgpack

from hapticd.gateway.peers import GREETING, LONG, MORE
from hapticd.mailbox import files

PATIENCE_S = 0.2  # for the kernel to accept or deliver data
GIVEN_UP_S = 60.0
REFUSED_S = 0.01  # before the next try
HELD_S = 0.5
PAUSE_S = 0.1  # in which the gateway detects that they have left
SLICE_S = 0.01
REQUESTS = tuple(
    msgpack.packb(one)
    for one in (
        {"cmd": "get"},
        {"cmd": "status"},
        {"cmd": "schema"},
        {"cmd": "hello", "name": "x" * 40},
        {"cmd": "set", "K": 1e9},
        {"cmd": "nothing"},
    )
)


def framed(body: bytes, flags: int = 0) -> bytes:
    """A frame of ZMTP."""
    if len(body) < 256:
        return bytes((flags, len(body))) + body
    return bytes((flags | LONG,)) + len(body).to_bytes(8, "big") + body


def introduction(kind: bytes) -> bytes:
    """Greeting and READY of a socket of `kind`."""
    name = b"\5READY\x0bSocket-Type"
    return GREETING + framed(name + len(kind).to_bytes(4, "big") + kind, 4)


class Peers:
    """Opens connections to the gateway in `folder`, and counts the pieces done and refused."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder = folder
        self.random = Random(seed)
        self.there: list[socket.socket] = []
        self.done = 0
        self.refused = 0
        self._taken_s = time.monotonic()  # when something was, last

    def count(self, done: int, refused: int) -> None:
        """Count pieces done and refused. SystemExit: none is accepted for GIVEN_UP_S."""
        self.done += done
        self.refused += refused
        if done:
            self._taken_s = time.monotonic()
        elif time.monotonic() - self._taken_s > GIVEN_UP_S:
            raise SystemExit(f"nothing was taken for {GIVEN_UP_S:g} s")
        else:
            time.sleep(REFUSED_S)

    def open(self, name: str, kind: bytes = b"") -> socket.socket | None:
        """Return a connection to the socket file `name`, introduced as `kind`; None if refused."""
        line = socket.socket(socket.AF_UNIX)
        line.settimeout(PATIENCE_S)
        try:
            line.connect(str(self.folder / name))
            if kind:
                line.sendall(introduction(kind))
        except OSError:
            line.close()
            return None
        self.there.append(line)
        return line

    def talk(self, name: str, kind: bytes) -> socket.socket | None:
        """As `open`, once the gateway has greeted; None: it did not."""
        line = self.open(name, kind)
        if line is None or greeted(line, PATIENCE_S):
            return line
        self.there.remove(line)
        line.close()
        return None

    def close(self) -> int:
        """All of them; how many the gateway had greeted."""
        found = sum(greeted(line, 0.0) for line in self.there)
        for line in self.there:
            line.close()
        self.there.clear()
        return found


def greeted(line: socket.socket, wait_s: float) -> bool:
    """Return whether the gateway accepted this connection; it greets at once if so."""
    line.settimeout(wait_s)
    try:
        return bool(line.recv(1, socket.MSG_PEEK))
    except OSError:
        return False
    finally:
        line.settimeout(PATIENCE_S)


def send(line: socket.socket, data: bytes) -> int:
    """Return the number of bytes of `data` that were accepted."""
    taken = 0
    with suppress(OSError):
        while taken < len(data):
            taken += line.send(memoryview(data)[taken:])
    return taken


def drain(line: socket.socket) -> None:
    """Read all available data."""
    line.setblocking(False)
    with suppress(OSError):
        while line.recv(1 << 16):
            pass
    line.settimeout(PATIENCE_S)


class Lines:
    """Connections of one peer, each opened again when it does not accept the data."""

    def __init__(self, peers: Peers) -> None:
        self._peers = peers
        self._lines: dict[tuple[int, str], socket.socket | None] = {}

    def burst(
        self, place: int, name: str, kind: bytes, pieces: list[bytes]
    ) -> socket.socket | None:
        """Send `pieces` on the connection number `place` to `name`, and count them. Return the
        connection, or None if it did not accept all of them.
        """
        key = (place, name)
        line = self._lines.get(key) or self._peers.talk(name, kind)
        ends = list(accumulate(map(len, pieces)))
        taken = 0 if line is None else send(line, b"".join(pieces))
        whole = sum(end <= taken for end in ends)
        self._peers.count(whole, len(pieces) - whole)
        if line is not None and whole < len(pieces):
            self._peers.there.remove(line)
            line.close()
            line = None
        self._lines[key] = line
        return line


def flood(peers: Peers, pieces: int) -> None:
    """Send requests as fast as they are accepted, on four connections; every second one reads."""
    lines = Lines(peers)
    turn = 0
    while peers.done < pieces:
        place = turn % 4
        turn += 1
        burst = [framed(peers.random.choice(REQUESTS)) for _ in range(20)]
        line = lines.burst(place, files.COMMAND_SOCKET, b"DEALER", burst)
        if line is not None and place % 2:
            drain(line)


def slow_readers(peers: Peers, pieces: int) -> None:
    """Subscribe to everything and read a byte now and then, or never; 100 peers at a time."""
    while peers.done < pieces:
        asked = min(100, pieces - peers.done)
        for _ in range(asked):
            line = peers.open(files.TELEMETRY_SOCKET, b"SUB")
            if line is not None:
                line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                send(line, framed(b"\1"))
        _trickle(peers)
        done = peers.close()
        peers.count(done, asked - done)
        time.sleep(PAUSE_S)


def _trickle(peers: Peers) -> None:
    ends = time.monotonic() + HELD_S
    while time.monotonic() < ends:
        for line in peers.there[::2]:
            with suppress(OSError):
                line.setblocking(False)
                line.recv(1)
        time.sleep(0.01)


def half_open(peers: Peers, pieces: int) -> None:
    """Leave connections in the middle of greeting, READY or a frame, or at once."""
    whole = introduction(b"DEALER") + framed(REQUESTS[1]) + framed(bytes(60_000))
    while peers.done < pieces:
        asked = min(60, pieces - peers.done)
        for _ in range(asked):
            line = peers.open(peers.random.choice((files.COMMAND_SOCKET, files.TELEMETRY_SOCKET)))
            if line is not None:
                send(line, whole[: peers.random.randrange(len(whole))])
        ends = time.monotonic() + HELD_S
        while time.monotonic() < ends and not all(greeted(one, 0.0) for one in peers.there):
            time.sleep(SLICE_S)
        done = peers.close()
        peers.count(done, asked - done)


def crowd(peers: Peers, pieces: int) -> None:
    """Connections that stay, 500 at a time, on both sockets."""
    while peers.done < pieces:
        for _ in range(250):
            peers.open(files.COMMAND_SOCKET, b"DEALER")
            peers.open(files.TELEMETRY_SOCKET, b"SUB")
        time.sleep(HELD_S)
        done = peers.close()
        peers.count(done, 500 - done)
        time.sleep(PAUSE_S)


def subscriptions(peers: Peers, pieces: int) -> None:
    """Subscriptions that come and go, thousands to a connection."""
    lines = Lines(peers)
    while peers.done < pieces:
        topic = peers.random.randbytes(peers.random.choice((1, 8, 200)))
        storm = [framed(bytes((n % 2,)) + topic[: n % 9]) for n in range(200)]
        line = lines.burst(0, files.TELEMETRY_SOCKET, b"SUB", storm)
        if line is not None:
            drain(line)


def multipart(peers: Peers, pieces: int) -> None:
    """Messages without an end, on both sockets; a piece is a part."""
    lines = Lines(peers)
    while peers.done < pieces:
        name = peers.random.choice((files.COMMAND_SOCKET, files.TELEMETRY_SOCKET))
        kind = b"DEALER" if name == files.COMMAND_SOCKET else b"XSUB"
        part = framed(bytes(peers.random.choice((0, 10, 255, 3000))), MORE)
        lines.burst(0, name, kind, [part] * 20)


def killed(peers: Peers, pieces: int) -> None:
    """Run clients that send requests, subscribe and hold a lease; kill each at a random moment
    after its first request. A client that could not send one within PATIENCE_S counts as refused.
    """
    lease = framed(msgpack.packb({"cmd": "lease", "what": "environment", "ttl_s": 5.0}))
    while peers.done < pieces:
        told, telling = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                _busy_client(peers, lease, telling)
            finally:
                os._exit(1)
        os.close(telling)
        asked, _, _ = select([told], [], [], PATIENCE_S)
        time.sleep(peers.random.uniform(0.0, 0.02))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        done = len(os.read(told, 1)) if asked else 0
        os.close(told)
        peers.count(done, 1 - done)


def _busy_client(peers: Peers, lease: bytes, telling: int) -> None:
    """Write a byte to `telling` after the first request; never return."""
    while True:
        asking = peers.talk(files.COMMAND_SOCKET, b"DEALER")
        told = peers.open(files.TELEMETRY_SOCKET, b"SUB")
        burst = lease + framed(REQUESTS[2]) * 10
        for turn in range(200):
            if asking is None or send(asking, burst) < len(burst):
                break
            if turn == 0:
                os.write(telling, b"a")
            if told is not None:
                send(told, framed(b"\1servo"))
        peers.close()


def burn(peers: Peers, pieces: int) -> None:
    """No attack: computes for `pieces` of every thousand milliseconds, in slices, until ended."""
    busy_s = SLICE_S * min(1.0, pieces / 1000.0)
    while True:
        ends = time.process_time() + busy_s
        while time.process_time() < ends:
            sum(range(1000))
        time.sleep(SLICE_S - busy_s)


KINDS: dict[str, Callable[[Peers, int], None]] = {
    "floods": flood,
    "slow-readers": slow_readers,
    "half-open": half_open,
    "crowd": crowd,
    "subscriptions": subscriptions,
    "multipart": multipart,
    "killed-clients": killed,
    "burn": burn,
}


def main() -> None:
    """Attack."""
    kind, folder, pieces, seed = sys.argv[1:]
    peers = Peers(Path(folder), int(seed))
    KINDS[kind](peers, int(pieces))
    print(peers.done, peers.refused, flush=True)


if __name__ == "__main__":
    main()
