"""ZMTP 3.0, the protocol of ZeroMQ, for one side of one connection: bytes in, messages out. No I/O.

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

from collections.abc import Sequence

from hapticd.core.errors import WireError

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
