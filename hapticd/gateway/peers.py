"""Connections of the gateway: the addresses of one kind of socket, its peers, and their protocol.

Peers (`Port`, `Peer`). No call waits, and the cost of every peer is bounded:

    peers        MOST_PEERS at an address; further ones are closed
    handshake    HANDSHAKE_NS, then the connection ends
    input        one read of READ_BYTES, and no further read until that is parsed. `receive` returns
                 a limited number of messages, from each peer in turn, so a flood fills the kernel's
                 buffers and slows only its sender
    messages     length and number of parts as the session allows; beyond, the connection ends
    output       `messages` and QUEUED_BYTES; further messages are dropped, for that peer alone

The kernel reports a dead peer: at once on this machine; over TCP when its probes or data are
unanswered for SILENCE_S. A peer is identified by a number that is never reused.

`receive` must be called in every pass: a peer with unparsed input is not read before that.

Protocol (`Session`). ZMTP 3.0 is the protocol of ZeroMQ. A session is one side of one connection:
bytes in, messages out, no I/O.

    greeting   64 bytes: signature FF .. 7F, version 3.0, mechanism NULL, filler
    READY      a command with the kind of socket; an incompatible kind is refused
    frames     flags (1 more, 2 long, 4 command), length (1 or 8 bytes), body; a message consists of
               its frames up to the first one without `more`

Source: the ZeroMQ RFCs 23/ZMTP and 37/ZMTP. Every ZeroMQ library since 4.0 implements it. Commands
of newer versions are understood too: PING is answered, SUBSCRIBE and CANCEL are subscriptions.

The gateway implements the protocol itself; only clients and the relay use libzmq. libzmq bounds too
little of a peer's input, and aborts the process by an assertion when a peer dies behind a full
queue (ADR-0020). Here all input is bounded: a frame is checked by its length before its body is
awaited, a message by its parts and bytes as they arrive. A violation of a bound or of the protocol
is a WireError, and its connection ends.

A caller must not feed more while `take` still finds frames: the buffer would grow. A partner with
ZMTP 2 or older is refused.
"""

import selectors
import socket
from collections import deque
from collections.abc import Callable, Sequence
from itertools import count

from hapticd.core.errors import WireError
from hapticd.core.units import NS_PER_S

# --- the protocol ---------------------------------------------------------------------------------
_MECHANISM = b"NULL".ljust(20, b"\0")
GREETING = b"\xff" + bytes(8) + b"\x7f" + b"\x03\x00" + _MECHANISM + bytes(32)
VERSION_PLACE = 10
MECHANISM_PLACES = slice(12, 32)
MORE = 1
LONG = 2
COMMAND = 4
SHORT_BYTES = 255  # the longest body whose length is one byte
LONGEST_HANDSHAKE = 1024  # body of READY: a few properties
MOST_PARTS = 8  # of a message
PING_CONTEXT = 16  # bytes of a PING that are returned in its PONG
PARTNERS = {b"ROUTER": (b"REQ", b"DEALER", b"ROUTER"), b"XPUB": (b"SUB", b"XSUB")}

Message = tuple[bytes, ...]


def message(parts: Sequence[bytes]) -> bytes:
    """Return the bytes of a message."""
    *before, last = parts
    return b"".join(_frame(MORE, part) for part in before) + _frame(0, last)


def _frame(flags: int, body: bytes) -> bytes:
    if len(body) <= SHORT_BYTES:
        return bytes((flags, len(body))) + body
    return bytes((flags | LONG,)) + len(body).to_bytes(8, "big") + body


def _command(name: bytes, body: bytes) -> bytes:
    return _frame(COMMAND, bytes((len(name),)) + name + body)


def _ready(kind: bytes) -> bytes:
    name = b"Socket-Type"
    return _command(b"READY", bytes((len(name),)) + name + len(kind).to_bytes(4, "big") + kind)


class Session:
    """One side of a connection, as a socket of `kind` (a key of PARTNERS) that accepts messages of
    at most `longest` bytes.

    `outgoing` contains bytes to be sent before anything else; the caller removes them.
    """

    def __init__(self, kind: bytes, longest: int) -> None:
        self._kind = kind
        self._longest = longest
        self._buffer = bytearray()
        self._place = 0  # in the buffer, of the unparsed rest
        self._greeted = False
        self._parts: list[bytes] = []
        self.ready = False  # the handshake is complete: messages may be sent
        self.outgoing: list[bytes] = [GREETING]

    def feed(self, data: bytes) -> None:
        """Append input from the peer."""
        del self._buffer[: self._place]
        self._place = 0
        self._buffer += data

    def take(self) -> Message | None:
        """Return the next piece of the input: a message, or () for a part, a command or a greeting.

        None: no complete piece is available. WireError: the peer violates the protocol or a bound.
        """
        if not self._greeted:
            return self._greet()
        head = self._head()
        if head is None:
            return None
        flags, begin, length = head
        if len(self._buffer) < begin + length:
            return None
        self._place = begin + length
        body = bytes(self._buffer[begin : self._place])
        if flags & COMMAND:
            return self._obey(body)
        if not self.ready:
            raise WireError("a message before READY")
        return self._join(body, bool(flags & MORE))

    def _greet(self) -> Message | None:
        if self._buffer and not self._buffer.startswith(GREETING[:1]):
            raise WireError("no ZMTP greeting")
        if len(self._buffer) < len(GREETING):
            return None
        if self._buffer[VERSION_PLACE] < GREETING[VERSION_PLACE]:
            raise WireError(f"ZMTP {self._buffer[VERSION_PLACE]}, 3 is needed; use ZeroMQ 4")
        if self._buffer[MECHANISM_PLACES] != _MECHANISM:
            raise WireError("another mechanism than NULL")
        self._place = len(GREETING)
        self._greeted = True
        self.outgoing.append(_ready(self._kind))
        return ()

    def _head(self) -> tuple[int, int, int] | None:
        """Return flags, place and length of the next body, once its head is complete."""
        rest = len(self._buffer) - self._place
        if rest < 2:
            return None
        flags = self._buffer[self._place]
        if flags > MORE | LONG | COMMAND:
            raise WireError(f"frame with flags {flags:#x}")
        begin = self._place + (9 if flags & LONG else 2)
        if rest < begin - self._place:
            return None
        length = int.from_bytes(self._buffer[self._place + 1 : begin], "big")
        limit = self._longest if self.ready else LONGEST_HANDSHAKE
        if sum(map(len, self._parts)) + length > limit:
            raise WireError(f"a message of more than {limit} bytes")
        return flags, begin, length

    def _join(self, body: bytes, more: bool) -> Message:
        self._parts.append(body)
        if len(self._parts) > MOST_PARTS:
            raise WireError(f"a message of more than {MOST_PARTS} parts")
        if more:
            return ()
        whole = tuple(self._parts)
        self._parts.clear()
        return whole

    def _obey(self, body: bytes) -> Message:
        end = 1 + body[0] if body else 0
        name = body[1:end]
        rest = body[end:]
        if name == b"READY" and not self.ready:
            self._introduced(rest)
        elif name == b"ERROR" or not self.ready:
            raise WireError(f"{name[:16]!r} where READY was due")
        elif name == b"PING":
            # two bytes of time to live come before the context
            self.outgoing.append(_command(b"PONG", rest[2 : 2 + PING_CONTEXT]))
        elif name in (b"SUBSCRIBE", b"CANCEL"):
            return ((b"\1" if name == b"SUBSCRIBE" else b"\0") + rest,)
        return ()

    def _introduced(self, properties: bytes) -> None:
        kind = _properties(properties).get(b"socket-type", b"")
        if kind not in PARTNERS[self._kind]:
            raise WireError(f"a socket of kind {kind[:16]!r} does not go with {self._kind!r}")
        self.ready = True


def _properties(data: bytes) -> dict[bytes, bytes]:
    """Return values by name in lower case; an incomplete property ends the list."""
    found = {}
    place = 0
    while place < len(data):
        name_end = place + 1 + data[place]
        value_begin = name_end + 4
        value_end = value_begin + int.from_bytes(data[name_end:value_begin], "big")
        found[data[place + 1 : name_end].lower()] = data[value_begin:value_end]
        place = value_end
    return found


# --- peers ----------------------------------------------------------------------------------------
MOST_PEERS = 128
READ_BYTES = 64 * 1024
QUEUED_BYTES = 1 << 20
HANDSHAKE_NS = 3 * NS_PER_S
SILENCE_S = 6
PROBE_S = 2  # between two probes of a silent TCP peer
ACCEPTED_AT_ONCE = 16
READ = selectors.EVENT_READ
WRITE = selectors.EVENT_WRITE


class Peer:
    """One connection: its unparsed input and its queued output."""

    def __init__(
        self,
        identity: bytes,
        connection: socket.socket,
        session: Session,
        deadline_ns: int,
        came_to: socket.socket,
    ) -> None:
        self.identity = identity
        self.connection = connection
        self.came_to = came_to  # the listening socket
        self.session = session
        self.deadline_ns = deadline_ns  # of its handshake
        self.queue: deque[bytes] = deque()
        self.queued = 0  # bytes
        self.sent = 0  # bytes of the first one
        self.full = False  # with unparsed input
        self.watched = 0  # registered events

    def put(self, data: bytes) -> None:
        """Queue `data`."""
        self.queue.append(data)
        self.queued += len(data)

    def flush(self) -> None:
        """Send as much as the kernel accepts. OSError: the connection has ended."""
        while self.queue:
            first = self.queue[0]
            try:
                self.sent += self.connection.send(memoryview(first)[self.sent :])
            except BlockingIOError:
                return
            if self.sent < len(first):
                return
            self.queued -= len(self.queue.popleft())
            self.sent = 0


class Port:
    """The peers of one kind of socket (`PARTNERS`), watched by `selector`.

    `longest`: maximum bytes of a message; `messages`: maximum queued for a peer; `gone` is called
    with the identity of each peer whose connection ended.
    """

    def __init__(
        self,
        kind: bytes,
        longest: int,
        messages: int,
        selector: selectors.BaseSelector,
        gone: Callable[[bytes], None] = lambda identity: None,
    ) -> None:
        self._kind = kind
        self._longest = longest
        self._messages = messages
        self._selector = selector
        self._gone = gone
        self._listeners: list[socket.socket] = []
        self._peers: dict[bytes, Peer] = {}
        self._full: deque[Peer] = deque()  # in the order of their turns
        self._numbers = count(1)
        self._now_ns = 0

    def listen(self, listener: socket.socket) -> None:
        """Accept connections at `listener`, which is bound."""
        listener.setblocking(False)
        listener.listen(MOST_PEERS)
        self._listeners.append(listener)

        def attend(events: int) -> None:
            self._accept(listener)

        self._selector.register(listener, READ, attend)

    @property
    def busy(self) -> bool:
        """Whether there is unparsed input."""
        return bool(self._full)

    def tend(self, now_ns: int) -> None:
        """Note the time; end connections whose handshake is overdue."""
        self._now_ns = now_ns
        for peer in list(self._peers.values()):
            if not peer.session.ready and peer.deadline_ns <= now_ns:
                self._drop(peer)

    def receive(self, most: int) -> list[tuple[bytes, Message]]:
        """Return (identity, message) from up to `most` pieces of the input, each peer in turn."""
        found = []
        for _ in range(most):
            if not self._full:
                break
            peer = self._full.popleft()
            message = self._taken(peer)
            if message is None:
                peer.full = False
                self._watch(peer)
                continue
            self._full.append(peer)
            if message:
                found.append((peer.identity, message))
        return found

    def send(self, identity: bytes, data: bytes) -> bool:
        """Queue the bytes of a message; return whether its peer is connected and has room."""
        peer = self._peers.get(identity)
        room = (
            peer is not None
            and peer.session.ready
            and len(peer.queue) < self._messages
            and peer.queued + len(data) <= QUEUED_BYTES
        )
        if peer is not None and room:
            peer.put(data)
            self._flush(peer)
        return room

    def close(self) -> None:
        """End all connections and stop listening."""
        for peer in list(self._peers.values()):
            self._drop(peer)
        for listener in self._listeners:
            self._selector.unregister(listener)
            listener.close()
        self._listeners.clear()

    def _accept(self, listener: socket.socket) -> None:
        for _ in range(ACCEPTED_AT_ONCE):
            try:
                connection, _ = listener.accept()
            except OSError:  # none waits, or it has ended, or no descriptor is left
                return
            if self._guests(listener) < MOST_PEERS:
                self._welcome(connection, listener)
            else:
                connection.close()

    def _guests(self, listener: socket.socket) -> int:
        """Return the number of peers at `listener`: a full address leaves the others free."""
        return sum(peer.came_to is listener for peer in self._peers.values())

    def _welcome(self, connection: socket.socket, listener: socket.socket) -> None:
        connection.setblocking(False)
        if connection.family != socket.AF_UNIX:
            _notice_death(connection)
        identity = next(self._numbers).to_bytes(8, "big")
        session = Session(self._kind, self._longest)
        deadline_ns = self._now_ns + HANDSHAKE_NS
        peer = Peer(identity, connection, session, deadline_ns, listener)
        self._peers[identity] = peer
        self._answer(peer)

    def _ready(self, peer: Peer, events: int) -> None:
        if events & WRITE:
            self._flush(peer)
        if events & READ and peer.identity in self._peers:
            self._read(peer)

    def _read(self, peer: Peer) -> None:
        try:
            data = peer.connection.recv(READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(peer)
            return
        peer.session.feed(data)
        peer.full = True
        self._full.append(peer)
        self._watch(peer)

    def _taken(self, peer: Peer) -> Message | None:
        """Return the next message of `peer`; None also when it had to be dropped."""
        if peer.identity not in self._peers:
            return None
        try:
            message = peer.session.take()
        except WireError:
            self._drop(peer)
            return None
        self._answer(peer)
        return message

    def _answer(self, peer: Peer) -> None:
        while peer.session.outgoing:
            answer = peer.session.outgoing.pop(0)
            if len(peer.queue) < self._messages:
                peer.put(answer)
        self._flush(peer)

    def _flush(self, peer: Peer) -> None:
        try:
            peer.flush()
        except OSError:
            self._drop(peer)
        self._watch(peer)

    def _watch(self, peer: Peer) -> None:
        """Register for input if there is room, and for output if some is queued."""
        if peer.identity not in self._peers:
            return
        wanted = (0 if peer.full else READ) | (WRITE if peer.queue else 0)
        if wanted == peer.watched:
            return
        if peer.watched:
            self._selector.unregister(peer.connection)
        if wanted:

            def attend(events: int) -> None:
                self._ready(peer, events)

            self._selector.register(peer.connection, wanted, attend)
        peer.watched = wanted

    def _drop(self, peer: Peer) -> None:
        if self._peers.pop(peer.identity, None) is None:
            return
        if peer.watched:
            self._selector.unregister(peer.connection)
        peer.connection.close()
        self._gone(peer.identity)


def _notice_death(connection: socket.socket) -> None:
    """Let the kernel end a TCP connection whose other end is silent for SILENCE_S."""
    tcp = socket.IPPROTO_TCP
    connection.setsockopt(tcp, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(tcp, socket.TCP_KEEPIDLE, PROBE_S)
    connection.setsockopt(tcp, socket.TCP_KEEPINTVL, PROBE_S)
    connection.setsockopt(tcp, socket.TCP_KEEPCNT, SILENCE_S // PROBE_S)
    connection.setsockopt(tcp, socket.TCP_USER_TIMEOUT, 1000 * SILENCE_S)
