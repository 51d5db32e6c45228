"""What both ends must agree on beyond single frames: who they are, which frame comes next, and
numbers that wrap.

Handshake. `greet` takes a board's first reply. Nothing else is sent to a board before it has said
hello with the hash of our own header; a board that was lost says it again.

Sequence. Frames count modulo 2**16. USB keeps order, so only what lay in a buffer comes late: the
BACKWARD last numbers mean REORDERED, every other distance forward GAP. With half the circle each
way, a board that restarted its count would be REORDERED for up to 32768 frames; so it is one GAP,
then NEXT. More than 65470 lost frames (8 s at 8 kHz) cannot be told from late ones: the link is
given up long before.

Wrapping. A reading stands for the integer nearest to the one before it; unique while less than half
a period passes between two readings: 35 minutes of board time, 6 days of probe indices, 1 km of
travel at 0.5 um.

What would break it: keeping a `previous` across a re-plug (call `restart`, and unwrap from the
first reading anew).
"""

from enum import Enum, auto
from math import isfinite

from hapticd.core.errors import ProtocolMismatch
from hapticd.usb import codec, frames
from hapticd.usb.frames import HelloFrame

__all__ = ["ENCODER_BITS", "PROBE_INDEX_BITS", "unwrap"]

SEQ_BITS = 16
BOARD_TIME_BITS = 32
PROBE_INDEX_BITS = 32
ENCODER_BITS = 32
BACKWARD = 64
SEQ_MASK = (1 << SEQ_BITS) - 1


def greet(reply: bytes) -> HelloFrame:
    """The hello in the bytes of a board's reply, if we can work with it.

    The first 8 bytes are the protocol hash in every version, so a board of another version is named
    as such (ProtocolMismatch) even if the rest of its reply has another form. FrameError: a reply
    with our hash is malformed.
    """
    _check_hash(bytes(reply[: len(frames.PROTOCOL_HASH)]))
    hello = codec.decode_hello(reply)
    check_hello(hello)
    return hello


def check_hello(hello: HelloFrame) -> None:
    """Return if the host can work with this board, else ProtocolMismatch. What its device file
    relies on is not looked at here (`usb.agreement`).
    """
    _check_hash(hello.protocol_hash)
    board = f"board {hello.serial or 'without serial'}"
    if hello.axis_count != frames.AXIS_COUNT:
        raise ProtocolMismatch(
            f"{board} has {hello.axis_count} axes, expected 1; flash firmware for one axis"
        )
    if hello.watchdog_ms <= 0:
        raise ProtocolMismatch(
            f"{board} has a watchdog of 0 ms, limit > 0 ms; flash firmware that stops by itself"
        )
    for name in ("force_full_scale_n", "force_limit_n"):
        value = getattr(hello, name)
        if not (isfinite(value) and value > 0.0):
            raise ProtocolMismatch(
                f"{board} states {name} = {value:g} N, limit > 0 N; correct its firmware"
            )


def _check_hash(found: bytes) -> None:
    ours = frames.PROTOCOL_HASH.hex()
    if found != frames.PROTOCOL_HASH:
        raise ProtocolMismatch(
            f"the board speaks protocol {found.hex()}, this hapticd {ours}; flash firmware built"
            " against the hapticd_wire.h of this hapticd, or install the hapticd whose"
            " HAPTICD_PROTOCOL_HASH is the board's"
        )


def unwrap(previous: int, wrapped: int, bits: int) -> int:
    """The integer nearest to `previous` that reads `wrapped` in a counter of `bits` bits, signed or
    not.

    Exactly half a period away counts as backward.
    """
    half = 1 << (bits - 1)
    # `&` gives a remainder that is never negative; half a period on both sides makes it signed
    return previous + ((wrapped - previous + half) & (2 * half - 1)) - half


class Arrival(Enum):
    """What a sequence number says about its frame."""

    FIRST = auto()
    NEXT = auto()
    DUPLICATE = auto()
    GAP = auto()
    REORDERED = auto()


# made once: a frame allocates nothing, and `observe` tells them by identity
_NEXT = (Arrival.NEXT, 0)
_DUPLICATE = (Arrival.DUPLICATE, 0)
_REORDERED = (Arrival.REORDERED, 0)


def classify(previous: int | None, seq: int) -> tuple[Arrival, int]:
    """How frame `seq` follows the newest frame `previous` (None: there is none yet), and how
    many were lost between.
    """
    if previous is None:
        return Arrival.FIRST, 0
    step = (seq - previous) & SEQ_MASK
    if step == 1:
        return _NEXT
    if step == 0:
        return _DUPLICATE
    if step > SEQ_MASK - BACKWARD:
        return _REORDERED
    return Arrival.GAP, step - 1


class SequenceCounter:
    """Counts what became of the frames of one direction.

    IN: `observe(frame.seq)` for every valid frame. OUT: `observe(frame.echo)` on another counter;
    `lost` are then OUT frames that the board had not seen when it latched the IN after them:
    damaged, refused, or a tick late.
    """

    __slots__ = ("duplicates", "gaps", "lost", "newest", "received", "reordered")

    def __init__(self) -> None:
        self.newest: int | None = None
        self.received = 0
        self.lost = 0
        self.gaps = 0
        self.duplicates = 0
        self.reordered = 0

    def observe(self, seq: int) -> tuple[Arrival, int]:
        """Classify and count `seq`. A frame that comes late stays counted as lost: its tick is
        over.
        """
        found = classify(self.newest, seq)
        arrival, lost = found
        self.received += 1
        if found is _DUPLICATE:
            self.duplicates += 1
        elif found is _REORDERED:
            self.reordered += 1
        else:
            self.newest = seq
            self.lost += lost
            self.gaps += arrival is Arrival.GAP
        return found

    def restart(self) -> None:
        """Another life of the board: the next frame is FIRST again. The counts stay."""
        self.newest = None
