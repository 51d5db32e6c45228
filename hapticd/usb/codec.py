"""The protocol of a board on USB: interface of a link, frames with their CRC, and session.

Link (`Link`). Real and simulated boards share this interface: no caller distinguishes them.

Frames. There are two forms of the same rules. `encode_*`/`decode_*` give named values and clear
errors, for boards, tests and tools. `out_packer`/`in_parser` work in place on the servo's two
buffers, so that a tick allocates nothing that outlives it. A frame is accepted or refused as a
whole: length, CRC, count and axis must be right. Reserved bytes and samples beyond the count are
sent as 0 and ignored on receipt. The field order must be that of `frames` (the packers use the same
Struct objects). A buffer must be refilled, not replaced (both keep memoryviews of their buffer).
The caller must detect a short read (`in_parser` otherwise reads the frame of the tick before).

Handshake (`greet`). It checks a board's first reply. No other frame is sent before the board has
replied to hello with the hash of this package's header; a lost board must reply again.

Sequence (`lost_between`). Frames count modulo 2**16. USB keeps the order, so only buffered frames
arrive late. The last BACKWARD numbers are late frames; every other distance forward is a gap. With
half the circle each way, a board that restarted its count would seem late for up to 32768 frames;
here it is one gap. More than 65470 lost frames (8 s at 8 kHz) cannot be distinguished from late
ones: the link is given up long before.

Wrapping (`unwrap`). A reading represents the integer nearest to the one before it. This is unique
while less than half a period passes between two readings: 35 minutes of board time, 6 days of probe
indices, 1 km of travel at 0.5 um. A `previous` must not be kept across a re-plug (unwrap again from
the first reading).
"""

import struct
from abc import ABC, abstractmethod
from array import array
from binascii import crc_hqx
from collections.abc import Callable, Sequence
from math import isfinite
from typing import Any

from hapticd.core.errors import FrameError, ProtocolMismatch
from hapticd.usb import frames

__all__ = [
    "ENCODER_BITS",
    "ENGLISH_US",
    "HEAD_CURRENT",
    "HEAD_ENCODER",
    "HEAD_FIFO_LEVEL",
    "HEAD_INDEX_OFFSET",
    "HEAD_STATUS",
    "HEAD_TEMPERATURE",
    "I16_HIGHEST",
    "I16_LOWEST",
    "NO_SAMPLES",
    "PROBE_INDEX_BITS",
    "TORQUE_SEQUENCES",
    "U16_HIGHEST",
    "VENDOR_CLASS",
    "VENDOR_IN",
    "VENDOR_OUT",
    "backoff_s",
    "decode_hello",
    "decode_in",
    "decode_out",
    "encode_hello",
    "encode_in",
    "encode_out",
    "unwrap",
]

# --- link -----------------------------------------------------------------------------------------

VENDOR_CLASS = 0xFF  # of the board's interface
VENDOR_IN = 0xC0  # bmRequestType of requests to it
VENDOR_OUT = 0x40
ENGLISH_US = 0x0409  # language of its strings


class Link(ABC):
    """One board, one owner. Every call returns within the link's time-out or raises a LinkError.

    `in_flight`: `write` returns before its frame has arrived, and a frame may be in transit between
    calls (`usb.flight`).
    """

    in_flight = False

    @abstractmethod
    def open(self) -> None:
        """Find and claim the board. LinkLost: not found; LinkAccess: not allowed or in use."""

    @abstractmethod
    def close(self) -> None:
        """Release everything; never raises, may be called twice."""

    @abstractmethod
    def read(self, buffer: "array[int]") -> int:
        """Fill `buffer` (array('B'), one packet) with the next IN frame; return the number of
        bytes.

        LinkTimeout, LinkStalled, LinkLost.
        """

    @abstractmethod
    def write(self, buffer: "array[int]") -> None:
        """Send `buffer` (array('B')) as one OUT frame. LinkTimeout, LinkStalled, LinkLost."""

    def drain(self) -> None:  # noqa: B027  # nothing to do where `write` waits
        """Wait for the OUT frame in transit, up to the time-out; never raises.

        Call it between ticks only: the next `write` then finds the bus free.
        """

    @abstractmethod
    def request(self, request: frames.Request, length: int = 0, value: int = 0) -> bytes:
        """Send a vendor control request with wValue `value`; return its reply of at most `length`
        bytes.

        With `length` 0 it is an OUT request without data.
        """


def backoff_s(attempt: int) -> float:
    """Return the pause before the next search for a lost board: 50 ms, doubled each time, at most 1
    s.
    """
    return min(1.0, 0.05 * 2.0 ** min(attempt, 10))


# --- frames ---------------------------------------------------------------------------------------

# ends of a count: torque, perturbation, current, velocities and temperature are signed, the damping
# scale factor is not
I16_LOWEST = -32768
I16_HIGHEST = 32767
U16_HIGHEST = 65535
TORQUE_SEQUENCES = 256  # values of the low byte of a sequence number
# places in a head: the fields of frames.IN_SEALED, as returned by `in_parser`
HEAD_SEQ = 0
HEAD_ECHO = 1
HEAD_AXIS = 2
HEAD_PROBE_COUNT = 3
HEAD_STATUS = 4
HEAD_BOARD_TIME = 5
HEAD_ENCODER = 6
HEAD_CURRENT = 7
HEAD_TEMPERATURE = 10
HEAD_FIFO_LEVEL = 11
HEAD_LIFE = 12
HEAD_INDEX_OFFSET = 13
HEAD_EVENT_CODE = 15
HEAD_EVENT_AGE = 16
HEAD_TORQUE_AGE = 17
HEAD_TORQUE_SEQ = 19
HEAD_EVENT_SEQ = 20
HEAD_CRC = 21
HEAD_FIELDS = 22
NO_SAMPLES = (0,) * frames.PROBE_MAX
_NO_PAIRS = (0,) * (2 * frames.PAIR_MAX)
_PAIRS = frames.InFrame._fields.index("pairs")
_SERIAL_BYTES = 16


def crc16(data: bytes | bytearray | memoryview) -> int:
    """Return the CRC-16/CCITT-FALSE of `data` (0x29B1 for b"123456789")."""
    return crc_hqx(data, frames.CRC_INITIAL)


def _sealed(layout: struct.Struct, *values: Any) -> bytes:
    try:
        # pack a CRC of 0, and cut off its bytes
        body = layout.pack(*values, 0)[: -frames.CRC.size]
    except struct.error as error:
        raise FrameError(
            f"a value does not fit its field: {error}; scale or clamp it before encoding"
        ) from error
    return body + frames.CRC.pack(crc16(body))


def _opened(
    layout: struct.Struct, data: bytes | bytearray | memoryview, kind: str
) -> tuple[Any, ...]:
    _check_length(kind, len(data), layout.size, "is another protocol on the wire?")
    expected = crc16(memoryview(data)[: -frames.CRC.size])
    found = frames.CRC.unpack_from(data, layout.size - 2)[0]
    if expected != found:
        raise FrameError(
            f"{kind} frame has CRC 0x{found:04x}, expected 0x{expected:04x}; it was damaged on"
            " the way",
            "CRC",
        )
    return layout.unpack(data)


def _check_length(kind: str, found: int, expected: int, remedy: str) -> None:
    if found != expected:
        raise FrameError(
            f"{kind} frame has a length of {found} bytes, expected {expected}; {remedy}",
            "length",
        )


def _counted(kind: str, count: int, most: int) -> int:
    if count > most:
        raise FrameError(
            f"{kind} frame has a count of {count} probe values, limit {most}",
            "count",
        )
    return count


def _check_axis(kind: str, axis: int) -> None:
    if axis >= frames.AXIS_COUNT:
        raise FrameError(
            f"{kind} frame is for axis {axis}, limit {frames.AXIS_COUNT - 1}; this protocol has one"
            " axis",
            "axis",
        )


def encode_out(frame: frames.OutFrame) -> bytes:
    """Return the 32 bytes of an OUT frame. FrameError if a value does not fit its field."""
    *head, perturbation = frame
    count = _counted("OUT", len(perturbation), frames.PROBE_MAX)
    samples = (*perturbation, *NO_SAMPLES[count:])
    return _sealed(frames.OUT, *head, count, 0, *samples, b"")


def decode_out(data: bytes | bytearray | memoryview) -> frames.OutFrame:
    """Return the OUT frame in 32 bytes. FrameError with the field: length, CRC, count or axis."""
    seq, axis, flags, torque, damping, resistance, count, _, *samples, _, _ = _opened(
        frames.OUT, data, "OUT"
    )
    kept = tuple(samples[: _counted("OUT", count, frames.PROBE_MAX)])
    _check_axis("OUT", axis)
    return frames.OutFrame(seq, axis, flags, torque, damping, resistance, kept)


def encode_in(frame: frames.InFrame) -> bytes:
    """Return the 64 bytes of an IN frame. FrameError if a value does not fit its field."""
    seq, echo, axis, *latched = frame[:_PAIRS]
    count = _counted("IN", len(frame.pairs), frames.PAIR_MAX)
    flat = tuple(value for pair in frame.pairs for value in pair) + _NO_PAIRS[2 * count :]
    return _sealed(frames.IN, seq, echo, axis, count, *latched, *flat, *frame[_PAIRS + 1 :])


def decode_in(data: bytes | bytearray | memoryview) -> frames.InFrame:
    """Return the IN frame in 64 bytes. FrameError with the field: length, CRC, count or axis."""
    seq, echo, axis, count, *values, _ = _opened(frames.IN, data, "IN")
    latched = _PAIRS - 3
    behind = latched + len(_NO_PAIRS)
    flat = values[latched:behind]
    pairs = tuple(zip(flat[::2], flat[1::2], strict=True))
    kept = pairs[: _counted("IN", count, frames.PAIR_MAX)]
    _check_axis("IN", axis)
    return frames.InFrame._make((seq, echo, axis, *values[:latched], kept, *values[behind:]))


def encode_hello(hello: frames.HelloFrame) -> bytes:
    """Return the 80 bytes of a hello reply. FrameError if a value does not fit its field."""
    h = hello
    _check_hello_values(h)
    try:
        serial = h.serial.encode("ascii")
        head = (
            h.protocol_hash,
            h.firmware_version,
            h.axis_count,
            0,
            h.capabilities,
            h.watchdog_ms,
            serial,
        )
        # an OverflowError is a float that is too large for 32 bits
        return frames.HELLO.pack(*head, *h[6:], b"")
    except (struct.error, OverflowError) as error:
        raise FrameError(f"a value does not fit its field of the hello reply: {error}") from error


def decode_hello(data: bytes | bytearray | memoryview) -> frames.HelloFrame:
    """Return the hello reply in 80 bytes.

    FrameError with the field: length, serial, or a full scale that is not finite.
    """
    _check_length("hello", len(data), frames.HELLO_BYTES, "update the board's firmware")
    protocol, version, axes, _, capabilities, watchdog, serial, *scales, _ = frames.HELLO.unpack(
        data
    )
    hello = frames.HelloFrame(
        protocol,
        version,
        axes,
        capabilities,
        watchdog,
        # Latin-1 decodes every byte; other characters than ASCII are refused below
        serial.partition(b"\0")[0].decode("latin-1"),
        *scales,
    )
    _check_hello_values(hello)
    return hello


def _check_hello_values(hello: frames.HelloFrame) -> None:
    if len(hello.protocol_hash) != len(frames.PROTOCOL_HASH):
        raise FrameError(
            f"protocol hash of the hello reply has {len(hello.protocol_hash)} bytes, expected"
            f" {len(frames.PROTOCOL_HASH)}"
        )
    if len(hello.serial) > _SERIAL_BYTES or not (
        hello.serial.isascii() and hello.serial.isprintable()
    ):
        raise FrameError(
            f"serial {hello.serial!r} of the hello reply is not {_SERIAL_BYTES} or less printable"
            " ASCII characters",
            "serial",
        )
    for name, value in zip(frames.HelloFrame._fields[6:], hello[6:], strict=True):
        if not isfinite(value):
            raise FrameError(
                f"{name} of the hello reply is {value}, not a finite number; correct the board's"
                " firmware",
                "finite",
            )


def out_packer(buffer: "array[int]") -> Callable[..., None]:
    """Return `pack(seq, flags, torque, damping, resistance, count=0, samples=...)` into `buffer`
    (array('B'), 32 bytes).

    `samples` always has PROBE_MAX entries; those beyond `count` are 0. All values are counts that
    the caller has clamped to their fields; struct.error otherwise.
    """
    body = memoryview(buffer)[: frames.OUT_BYTES - frames.CRC.size]
    fill = frames.OUT.pack_into
    seal = frames.CRC.pack_into
    check = crc_hqx
    initial = frames.CRC_INITIAL
    offset = len(body)

    def pack(
        seq: int,
        flags: int,
        torque: int,
        damping: int,
        resistance: int,
        count: int = 0,
        samples: Sequence[int] = NO_SAMPLES,
    ) -> None:
        fill(buffer, 0, seq, 0, flags, torque, damping, resistance, count, 0, *samples, b"", 0)
        seal(buffer, offset, check(body, initial))

    return pack


def in_parser(buffer: "array[int]") -> Callable[[], tuple[int, ...] | None]:
    """Return `parse()` for the IN frame in `buffer` (array('B'), 64 bytes): its head, or None if
    refused.

    The rules are those of `decode_in`: CRC, count and axis; the caller has checked that 64 bytes
    were read. A head has the fields of IN_SEALED (see HEAD_SEQ and the others): seq, echo, axis,
    probe_count, status, board_time_us, encoder, current, voltage, emf_velocity, temperature,
    fifo_level, life, index_offset, probe_index, event_code, event_age_us, torque_age_us,
    damping_effect, torque_seq, event_seq, CRC. The pairs stay in the frame; `decode_in` returns
    them.
    """
    body = memoryview(buffer)[: frames.IN_BYTES - frames.CRC.size]
    unpack = frames.IN_SEALED.unpack_from
    check = crc_hqx
    initial = frames.CRC_INITIAL
    axes = frames.AXIS_COUNT
    most = frames.PAIR_MAX

    def parse() -> tuple[int, ...] | None:
        head = unpack(buffer)
        if (
            head[HEAD_CRC] != check(body, initial)
            or head[HEAD_AXIS] >= axes
            or head[HEAD_PROBE_COUNT] > most
        ):
            return None
        return head

    return parse


# --- session --------------------------------------------------------------------------------------

SEQ_BITS = 16
BOARD_TIME_BITS = 32
PROBE_INDEX_BITS = 32
ENCODER_BITS = 32
BACKWARD = 64
SEQ_MASK = (1 << SEQ_BITS) - 1


def greet(reply: bytes) -> frames.HelloFrame:
    """Return the hello in a board's reply, if the host can work with this board.

    The requirements of its device file are checked elsewhere (`usb.search`). The first 8 bytes
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
    hello = decode_hello(reply)
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
