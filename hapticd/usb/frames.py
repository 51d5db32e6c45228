"""The frames of firmware_iface/hapticd_wire.h in Python, and the fingerprint of that header.

The C header is the authoritative definition; test_wire_header.py compiles it and compares every
size, offset and constant with this file. The board must report PROTOCOL_HASH: a board built against
another header is refused. The fingerprint covers declarations only, not comments, white space or
its own line. Explanation and format of the header can therefore change without flashing a board.

A field added here must be added in the header, and a changed header needs another PROTOCOL_HASH
(`tests/unit/test_wire_header.py` computes it).
"""

import struct
from enum import IntEnum, IntFlag
from typing import NamedTuple

__all__ = [
    "CRC",
    "CRC_INITIAL",
    "EVENT_DEPTH",
    "EVENT_FRAMES",
    "FIFO_DEPTH",
    "FIFO_TARGET",
    "HELLO_BYTES",
    "IN_BYTES",
    "IN_EFFECT",
    "IN_HEAD",
    "IN_OFFSETS",
    "IN_PAIRS",
    "IN_SEALED",
    "IN_TAIL",
    "OUT",
    "OUT_BYTES",
    "OUT_OFFSETS",
    "PACKET_BYTES",
    "PAIR_MAX",
    "PROBE_MAX",
    "PROTOCOL_HASH",
    "USB_PRODUCT_ID",
    "USB_VENDOR_ID",
    "Capability",
    "HelloFrame",
    "OutFlag",
    "Request",
    "StatusBit",
]

PROTOCOL_HASH = bytes.fromhex("016b7228b39ec3ca")

USB_VENDOR_ID = 0x1209
USB_PRODUCT_ID = 0x0001
PACKET_BYTES = 64
OUT_BYTES = 32
IN_BYTES = 64
HELLO_BYTES = 80
AXIS_COUNT = 1
PROBE_MAX = 6
PAIR_MAX = 5
FIFO_DEPTH = 16
FIFO_TARGET = 8
PROBE_RATE_HZ = 4000
EVENT_DEPTH = 16
EVENT_FRAMES = 2
CRC_POLYNOMIAL = 0x1021
CRC_INITIAL = 0xFFFF

OUT = struct.Struct("<HBBhHhBB6h6sH")
OUT_BARE = struct.Struct("<HxBhHhxx")  # all before the samples, where axis and count are 0
IN = struct.Struct("<HHBBHIihhhhBBhI10hHHHHBBH")
IN_HEAD = struct.Struct("<HHBBHIihhhhBBhI")  # the first 32 bytes of IN: all before the pairs
IN_PAIRS = struct.Struct("<10h")
IN_TAIL = struct.Struct("<HHHHBB")  # between pairs and CRC: event, effect, number of the event
IN_EFFECT = struct.Struct("<HHB")  # of those: age, damping and sequence of the OUT in effect
# IN without its pairs
IN_SEALED = struct.Struct(f"{IN_HEAD.format}{IN_PAIRS.size}x{IN_TAIL.format[1:]}H")
HELLO = struct.Struct("<8sHBBHH16s8f16s")
CRC = struct.Struct("<H")
# offsets of fields, to read one without unpacking the frame
OUT_OFFSETS = {"torque": 4, "damping": 6}
IN_OFFSETS = {
    "probe_count": 5,
    "probe_index": 28,
    "pair": 32,
    "event_code": 52,
    "torque_age_us": 56,
}
assert (OUT.size, IN.size, HELLO.size) == (OUT_BYTES, IN_BYTES, HELLO_BYTES)
assert IN_SEALED.size == IN_BYTES
assert IN_OFFSETS["event_code"] == IN_HEAD.size + IN_PAIRS.size
assert IN_OFFSETS["event_code"] + IN_TAIL.size + CRC.size == IN_BYTES


class Request(IntEnum):
    """Vendor control requests."""

    HELLO = 0x01
    CLEAR_FAULT = 0x02
    SAMPLE_PHASE = 0x03


class OutFlag(IntFlag):
    """Bits of `flags` in an OUT frame."""

    ENABLE = 0x01
    FIFO_CLEAR = 0x02
    PERTURB = 0x04


class StatusBit(IntFlag):
    """Bits of `status` in an IN frame."""

    ENABLED = 0x0001
    WATCHDOG = 0x0002
    BAD_FRAME = 0x0004
    SEQ_GAP = 0x0008
    FORCE_CLAMPED = 0x0010
    FIFO_UNDERRUN = 0x0020
    FIFO_OVERFLOW = 0x0040
    OVER_TEMPERATURE = 0x0080
    AMPLIFIER_FAULT = 0x0100
    ENCODER_FAULT = 0x0200
    INDEX = 0x0400
    PROBE_OVERFLOW = 0x0800
    EMERGENCY_STOP = 0x1000
    AMPLIFIER_READY = 0x2000
    SIMULATED = 0x8000


class Capability(IntFlag):
    """Bits of `capabilities` in the hello reply."""

    PROBE = 0x0001
    INTERVAL_MEAN = 0x0002
    INDEX = 0x0004
    TEMPERATURE = 0x0008
    RESISTANCE = 0x0010
    EMERGENCY_STOP = 0x0020
    AMPLIFIER_READY = 0x0040
    SAMPLE_PHASE = 0x0080
    RESISTANCE_MEASURED = 0x0100
    RESISTANCE_TRACKED = 0x0200
    EVENT = 0x0400
    SIMULATED = 0x8000


class OutFrame(NamedTuple):
    """Host to board. All numbers are counts."""

    seq: int
    axis: int = 0
    flags: int = 0
    torque: int = 0
    damping: int = 0
    resistance: int = 0
    perturbation: tuple[int, ...] = ()  # at most PROBE_MAX


class InFrame(NamedTuple):
    """Board to host. All numbers are counts, except `board_time_us` and ages."""

    seq: int
    echo: int
    axis: int
    status: int
    board_time_us: int
    encoder: int
    current: int
    voltage: int
    emf_velocity: int
    temperature: int
    fifo_level: int
    life: int
    index_offset: int
    probe_index: int
    pairs: tuple[tuple[int, int], ...] = ()  # (torque, velocity), at most PAIR_MAX
    event_code: int = 0
    event_age_us: int = 0
    torque_age_us: int = 0
    damping_effect: int = 0
    torque_seq: int = 0
    event_seq: int = 0


class HelloFrame(NamedTuple):
    """The description of a board by itself."""

    protocol_hash: bytes
    firmware_version: int
    axis_count: int
    capabilities: int
    watchdog_ms: int
    serial: str
    force_full_scale_n: float
    damping_full_scale_ns_per_m: float
    probe_torque_full_scale_n: float
    probe_velocity_full_scale_m_s: float
    current_full_scale_a: float
    voltage_full_scale_v: float
    position_m_per_count: float
    force_limit_n: float

    @property
    def firmware(self) -> str:
        """`firmware_version` in the usual form, like 1.0."""
        return f"{self.firmware_version >> 8}.{self.firmware_version & 0xFF}"
