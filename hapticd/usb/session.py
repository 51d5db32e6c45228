"""The session with a board: handshake, sequence of frames, and numbers that wrap.

Handshake. `greet` checks a board's first reply. No other frame is sent before the board has replied
to hello with the hash of this package's header; a lost board must reply again.

Sequence. Frames count modulo 2**16. USB keeps the order, so only buffered frames arrive late. The
last BACKWARD numbers are late frames; every other distance forward is a gap. With half the circle
each way, a board that restarted its count would seem late for up to 32768 frames; here it is one
gap. More than 65470 lost frames (8 s at 8 kHz) cannot be distinguished from late ones: the link is
given up long before.

Wrapping. A reading represents the integer nearest to the one before it. This is unique while less
than half a period passes between two readings: 35 minutes of board time, 6 days of probe indices, 1
km of travel at 0.5 um.

A `previous` must not be kept across a re-plug (unwrap again from the first reading).
"""

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
    """Return the hello in a board's reply, if the host can work with this board.

    The requirements of its device file are checked elsewhere (`usb.agreement`). The first 8 bytes
    are the protocol hash in every version. A board of another version is therefore identified
    (ProtocolMismatch) even if the rest of its reply has another form. FrameError: a reply with the
    right hash is malformed.
    """
    found = bytes(reply[: len(frames.PROTOCOL_HASH)])
    if found != frames.PROTOCOL_HASH:
        raise ProtocolMismatch(
            f"the board speaks protocol {found.hex()}, this hapticd {frames.PROTOCOL_HASH.hex()};"
            " flash firmware built against the hapticd_wire.h of this hapticd, or install the"
            " hapticd whose HAPTICD_PROTOCOL_HASH is the board's"
        )
    hello = codec.decode_hello(reply)
    board = f"board {hello.serial or 'without serial'}"
    if hello.axis_count != frames.AXIS_COUNT:
        raise ProtocolMismatch(
            f"{board} has {hello.axis_count} axes, expected 1; flash firmware for one axis"
        )
    if hello.watchdog_ms <= 0:
        raise ProtocolMismatch(
            f"{board} has a watchdog of 0 ms, limit > 0 ms; flash firmware with a watchdog"
        )
    for name in ("force_full_scale_n", "force_limit_n"):
        value = getattr(hello, name)
        if not value > 0.0:
            raise ProtocolMismatch(
                f"{board} states {name} = {value:g} N, limit > 0 N; correct its firmware"
            )
    return hello


def unwrap(previous: int, wrapped: int, bits: int) -> int:
    """Return the integer nearest to `previous` that reads `wrapped` in a counter of `bits` bits,
    signed or not.

    Exactly half a period away counts as backward.
    """
    half = 1 << (bits - 1)
    # `&` gives a remainder that is never negative; half a period on both sides makes it signed
    return previous + ((wrapped - previous + half) & (2 * half - 1)) - half


def lost_between(previous: int, seq: int) -> int:
    """Return the number of frames lost between the newest one, `previous`, and `seq`. It is 0 if
    `seq` is late or a duplicate.
    """
    step = (seq - previous) & SEQ_MASK
    return step - 1 if 0 < step <= SEQ_MASK - BACKWARD else 0
