"""Bytes <-> frames: what is refused, and that the servo's in-place form agrees with the named
one.
"""

import struct
from array import array
from itertools import combinations
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticd.core.errors import FrameError
from hapticd.usb import codec, frames
from hapticd.usb.frames import HelloFrame, InFrame, OutFrame

repeatable = settings(deadline=None, derandomize=True, database=None, max_examples=300)


OUT = OutFrame(1000, 0, 5, 4915, 11403, -7, (1638, 3277, -1638))
IN = InFrame(
    1001,
    1000,
    0,
    1,
    1_001_875,
    -2400,
    4915,
    6608,
    1311,
    3125,
    8,
    7,
    0,
    4003,
    ((819, 1302), (-1638, 1318)),
    17,
    420,
    875,
    11403,
    232,
    3,
)
HELLO = HelloFrame(
    frames.PROTOCOL_HASH, 0x0102, 1, 3, 20, "HD-0001", 8.0, 10.0, 2.0, 0.5, 4.0, 24.0, 2.0**-21, 8.0
)


def bitwise_crc(data: bytes) -> int:
    """The definition: one shift and one conditional xor per bit."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def resealed(data: bytes) -> bytes:
    return data[:-2] + struct.pack("<H", bitwise_crc(data[:-2]))


def flipped(data: bytes, *bits: int) -> bytes:
    changed = bytearray(data)
    for bit in bits:
        changed[bit >> 3] ^= 1 << (bit & 7)
    return bytes(changed)


def test_crc_has_the_published_check_value() -> None:
    assert codec.crc16(b"123456789") == bitwise_crc(b"123456789") == 0x29B1


@repeatable
@given(st.binary(max_size=80))
def test_crc_equals_its_definition(data: bytes) -> None:
    assert codec.crc16(data) == bitwise_crc(data)


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_any_buffer_is_decoded(kind: Any) -> None:
    assert codec.decode_out(kind(codec.encode_out(OUT))) == OUT
    assert codec.decode_in(kind(codec.encode_in(IN))) == IN
    assert codec.decode_hello(kind(codec.encode_hello(HELLO))) == HELLO


@pytest.mark.parametrize(
    ("data", "decode"),
    [(codec.encode_out(OUT), codec.decode_out), (codec.encode_in(IN), codec.decode_in)],
)
def test_every_bit_flip_is_refused(data: bytes, decode: Any) -> None:
    for bit in range(8 * len(data)):
        with pytest.raises(FrameError, match="CRC"):
            decode(flipped(data, bit))


@pytest.mark.parametrize("data", [codec.encode_out(OUT), codec.encode_in(IN)])
def test_every_two_bit_error_changes_crc(data: bytes) -> None:
    good = struct.unpack("<H", data[-2:])[0]
    syndromes = [codec.crc16(flipped(data, bit)[:-2]) ^ good for bit in range(8 * len(data) - 16)]
    syndromes += [1 << bit for bit in range(16)]
    assert all(a ^ b for a, b in combinations(syndromes, 2))
    assert all(syndromes)


@pytest.mark.parametrize("size", [*range(32), 33, 64])
def test_out_of_other_length_is_refused(size: int) -> None:
    data = (codec.encode_out(OUT) * 2)[:size]
    with pytest.raises(
        FrameError,
        match=rf"^OUT frame has a length of {size} bytes, expected 32; is another protocol",
    ):
        codec.decode_out(data)


@pytest.mark.parametrize("size", [*range(64), 65, 128])
def test_in_of_other_length_is_refused(size: int) -> None:
    data = (codec.encode_in(IN) * 2)[:size]
    with pytest.raises(
        FrameError,
        match=rf"^IN frame has a length of {size} bytes, expected 64; is another protocol",
    ):
        codec.decode_in(data)


@pytest.mark.parametrize("size", [0, 8, 64, 79, 81])
def test_hello_of_other_length_is_refused(size: int) -> None:
    with pytest.raises(
        FrameError,
        match=rf"^hello frame has a length of {size} bytes, expected 80; update the board's",
    ):
        codec.decode_hello((codec.encode_hello(HELLO) * 2)[:size])


def test_crc_message_names_both_values() -> None:
    data = codec.encode_out(OUT)[:-2]
    expected = bitwise_crc(data)
    with pytest.raises(
        FrameError, match=rf"^OUT frame has CRC 0x1234, expected 0x{expected:04x}; it was damaged"
    ):
        codec.decode_out(data + b"\x34\x12")


@pytest.mark.parametrize("count", [7, 8, 255])
def test_counts_beyond_the_room_are_refused(count: int) -> None:
    out = bytearray(codec.encode_out(OUT))
    received = bytearray(codec.encode_in(IN))
    out[10] = received[5] = count
    with pytest.raises(
        FrameError, match=rf"^OUT frame has a count of {count} probe values, limit 6"
    ):
        codec.decode_out(resealed(bytes(out)))
    with pytest.raises(
        FrameError, match=rf"^IN frame has a count of {count} probe values, limit 5"
    ):
        codec.decode_in(resealed(bytes(received)))


def test_too_many_samples_are_refused() -> None:
    with pytest.raises(FrameError, match="OUT frame has a count of 7 probe values, limit 6"):
        codec.encode_out(OUT._replace(perturbation=(0,) * 7))
    with pytest.raises(FrameError, match="IN frame has a count of 6 probe values, limit 5"):
        codec.encode_in(IN._replace(pairs=((0, 0),) * 6))


@pytest.mark.parametrize("axis", [1, 255])
def test_frames_of_another_axis_are_refused(axis: int) -> None:
    with pytest.raises(
        FrameError, match=rf"^OUT frame is for axis {axis}, limit 0; this protocol has one axis"
    ):
        codec.decode_out(codec.encode_out(OUT._replace(axis=axis)))
    with pytest.raises(
        FrameError, match=rf"^IN frame is for axis {axis}, limit 0; this protocol has one axis"
    ):
        codec.decode_in(codec.encode_in(IN._replace(axis=axis)))


def test_what_lies_beyond_the_count_is_ignored() -> None:
    out = bytearray(codec.encode_out(OUT))
    received = bytearray(codec.encode_in(IN))
    out[11], out[18:30] = 0xFF, b"\xff" * 12  # reserved0, samples 3 to 5, reserved
    received[40:52] = b"\xff" * 12  # pairs 2 to 4
    assert codec.decode_out(resealed(bytes(out))) == OUT
    assert codec.decode_in(resealed(bytes(received))) == IN


FIELDS_OUT = {
    "seq": 65536,
    "axis": 256,
    "flags": 256,
    "torque": 32768,
    "damping": -1,
    "resistance": -32769,
}
FIELDS_IN = {
    "seq": -1,
    "echo": 65536,
    "axis": 256,
    "status": 65536,
    "board_time_us": 1 << 32,
    "encoder": 1 << 31,
    "current": 32768,
    "voltage": -32769,
    "emf_velocity": 32768,
    "temperature": 32768,
    "fifo_level": 256,
    "index_offset": 32768,
    "probe_index": -1,
    "event_code": 65536,
    "event_age_us": -1,
    "event_seq": 256,
}


@pytest.mark.parametrize(("name", "value"), [*FIELDS_OUT.items(), ("perturbation", (32768,))])
def test_out_value_beyond_field_is_refused(name: str, value: Any) -> None:
    with pytest.raises(
        FrameError, match=r"^a value does not fit its field: .*; scale or clamp it before encoding"
    ):
        codec.encode_out(OUT._replace(**{name: value}))


@pytest.mark.parametrize(
    ("name", "value"), [*FIELDS_IN.items(), ("pairs", ((0, -32769),)), ("pairs", ((0,),))]
)
def test_in_value_beyond_field_is_refused(name: str, value: Any) -> None:
    with pytest.raises(
        FrameError, match=r"^a value does not fit its field: .*; scale or clamp it before encoding"
    ):
        codec.encode_in(IN._replace(**{name: value}))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1.0])
def test_no_float_reaches_a_count(value: float) -> None:
    with pytest.raises(FrameError, match=r"(not|required argument is not) an integer"):
        codec.encode_out(OUT._replace(torque=value))
    with pytest.raises(FrameError, match=r"(not|required argument is not) an integer"):
        codec.encode_in(IN._replace(encoder=value))


@pytest.mark.parametrize("name", HelloFrame._fields[6:])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_hello_scales_are_finite(name: str, value: float) -> None:
    data = bytearray(codec.encode_hello(HELLO))
    struct.pack_into("<f", data, 32 + 4 * HelloFrame._fields[6:].index(name), value)
    with pytest.raises(
        FrameError, match=rf"^{name} of the hello reply is {value}, not a finite number; correct"
    ):
        codec.decode_hello(bytes(data))
    with pytest.raises(FrameError, match=name):
        codec.encode_hello(HELLO._replace(**{name: value}))


@pytest.mark.parametrize("serial", ["é", "a\nb", "\x1b[2J", "12345678901234567"])
def test_hello_serial_is_short_printable_ascii(serial: str) -> None:
    with pytest.raises(
        FrameError, match=r"^serial '.*' of the hello reply is not 16 or less printable ASCII"
    ):
        codec.encode_hello(HELLO._replace(serial=serial))


def test_hello_serial_ends_at_first_zero() -> None:
    data = bytearray(codec.encode_hello(HELLO))
    data[16:32] = b"AB\0\xff" + b"junk" * 3
    assert codec.decode_hello(bytes(data)).serial == "AB"


@pytest.mark.parametrize(
    ("name", "value"), [("force_limit_n", 1e39), ("firmware_version", 65536), ("axis_count", -1)]
)
def test_hello_value_beyond_field_is_refused(name: str, value: float) -> None:
    with pytest.raises(FrameError, match=r"^a value does not fit its field of the hello reply: "):
        codec.encode_hello(HELLO._replace(**{name: value}))


def test_hello_hash_has_eight_bytes() -> None:
    with pytest.raises(
        FrameError, match=r"^protocol hash of the hello reply has 7 bytes, expected 8"
    ):
        codec.encode_hello(HELLO._replace(protocol_hash=bytes(7)))


def test_out_packer_sends_no_samples_by_default() -> None:
    buffer = array("B", b"\xff" * frames.OUT_BYTES)
    codec.out_packer(buffer)(7, 1, -2, 3, -4)
    assert buffer.tobytes() == codec.encode_out(OutFrame(7, 0, 1, -2, 3, -4))
