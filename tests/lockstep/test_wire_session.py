"""Who the board is, which frame comes next, and numbers that wrap."""

import struct
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticd.core.errors import FrameError, ProtocolMismatch
from hapticd.usb import codec, frames
from hapticd.usb.codec import greet, lost_between, unwrap
from hapticd.usb.frames import HelloFrame

repeatable = settings(deadline=None, derandomize=True, database=None, max_examples=300)

HELLO = HelloFrame(
    frames.PROTOCOL_HASH,
    0x0102,
    1,
    0x0003,
    20,
    "HD-0001",
    8.0,
    10.0,
    2.0,
    0.5,
    4.0,
    24.0,
    5e-7,
    8.0,
)
OTHER = bytes.fromhex("0123456789abcdef")


# --- hello ----------------------------------------------------------------------------------------


def test_right_board_is_greeted() -> None:
    assert greet(codec.encode_hello(HELLO)).serial == "HD-0001"
    assert greet(codec.encode_hello(HELLO._replace(position_m_per_count=0.5))).serial == "HD-0001"


MISMATCH = (
    r"^the board speaks protocol 0123456789abcdef, this hapticd "
    + frames.PROTOCOL_HASH.hex()
    + r"; flash firmware built against the hapticd_wire\.h of this hapticd, or install the hapticd"
    r" whose "
    r"HAPTICD_PROTOCOL_HASH is the board's$"
)


def test_other_hash_is_refused_with_remedy() -> None:
    with pytest.raises(ProtocolMismatch, match=MISMATCH):
        greet(codec.encode_hello(HELLO._replace(protocol_hash=OTHER)))


@pytest.mark.parametrize("rest", [b"", b"\xff" * 72, bytes(200)])
def test_reply_of_other_version_is_named_first(rest: bytes) -> None:
    with pytest.raises(ProtocolMismatch, match=MISMATCH):
        greet(OTHER + rest)


def test_malformed_reply_with_our_hash() -> None:
    with pytest.raises(FrameError, match="length of 79 bytes, expected 80"):
        greet(codec.encode_hello(HELLO)[:-1])


@pytest.mark.parametrize("axes", [0, 2])
def test_other_axis_count_is_refused(axes: int) -> None:
    with pytest.raises(
        ProtocolMismatch,
        match=rf"^board HD-0001 has {axes} axes, expected 1; flash firmware for one",
    ):
        greet(codec.encode_hello(HELLO._replace(axis_count=axes)))


def test_board_without_watchdog_is_refused() -> None:
    with pytest.raises(
        ProtocolMismatch, match=r"^board without serial has a watchdog of 0 ms, limit > 0 ms; flash"
    ):
        greet(codec.encode_hello(HELLO._replace(watchdog_ms=0, serial="")))


@pytest.mark.parametrize("name", ["force_full_scale_n", "force_limit_n"])
@pytest.mark.parametrize("value", [0.0, -8.0])
def test_board_without_force_is_refused(name: str, value: float) -> None:
    with pytest.raises(
        ProtocolMismatch,
        match=rf"^board HD-0001 states {name} = {value:g} N, limit > 0 N; correct its",
    ):
        greet(codec.encode_hello(HELLO._replace(**{name: value})))


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_board_with_a_force_that_is_no_number_is_refused(value: float) -> None:
    reply = bytearray(codec.encode_hello(HELLO))
    place = reply.index(struct.pack("<f", HELLO.force_full_scale_n))
    reply[place : place + 4] = struct.pack("<f", value)
    with pytest.raises(FrameError, match="force_full_scale_n of the hello reply is"):
        greet(bytes(reply))


# --- wrapping -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("previous", "wrapped", "bits", "expected"),
    [
        (65_535, 0, 16, 65_536),
        (65_536, 65_535, 16, 65_535),
        (2**32 - 1, 499, 32, 2**32 + 499),
        (2**32, 2**32 - 1, 32, 2**32 - 1),
        (2**31 - 1, -(2**31), 32, 2**31),  # encoder, forward over its sign
        (-(2**31), 2**31 - 1, 32, -(2**31) - 1),  # encoder, backward
        (0, -1, 32, -1),
        (-5, 3, 32, 3),
        (10 * 2**16 + 7, 7, 16, 10 * 2**16 + 7),
        (0, 2**15 - 1, 16, 2**15 - 1),
        (0, 2**15, 16, -(2**15)),  # exactly half a period counts as backward
    ],
)
def test_unwrap_across_the_wrap(previous: int, wrapped: int, bits: int, expected: int) -> None:
    assert unwrap(previous, wrapped, bits) == expected


@repeatable
@given(st.integers(-(10**15), 10**15), st.sampled_from([16, 32]), st.booleans(), st.data())
def test_unwrap_finds_any_near_value(
    previous: int, bits: int, signed: bool, data: st.DataObject
) -> None:
    half = 1 << (bits - 1)
    true = previous + data.draw(st.integers(-half, half - 1))
    wrapped = true % (2 * half)
    if signed and wrapped >= half:
        wrapped -= 2 * half
    assert unwrap(previous, wrapped, bits) == true


def test_board_time_of_24_hours() -> None:
    true_us = range(2**32 - 5_000_000, 2**32 + 86_400_000_000, 250_007)
    time_us = true_us[0]
    for true in true_us[1:]:
        time_us = unwrap(time_us, true & 0xFFFFFFFF, codec.BOARD_TIME_BITS)
        assert time_us == true


def test_probe_index_and_encoder_wrap_both_ways() -> None:
    forward = list(range(2**32 - 40, 2**32 + 40, 4))
    for path in (forward, forward[::-1]):
        for before, after in pairwise(path):
            assert unwrap(before, after % 2**32, codec.PROBE_INDEX_BITS) == after
            signed = after % 2**32 - 2**31
            assert unwrap(before - 2**31, signed, codec.ENCODER_BITS) == after - 2**31


# --- sequence -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("previous", "seq", "lost"),
    [
        (0, 1, 0),
        (65_535, 0, 0),
        (0, 0, 0),  # once more
        (65_535, 65_535, 0),
        (0, 2, 1),
        (65_534, 3, 4),
        (0, 65_471, 65_470),  # the farthest gap
        (0, 65_472, 0),  # 64 back: the oldest late frame
        (0, 65_535, 0),
        (3, 65_534, 0),
        (100, 99, 0),
        (100, 36, 0),
        (100, 35, 65_470),
        (40_000, 0, 25_535),  # a board that began to count anew is one gap
    ],
)
def test_frames_lost_before_a_frame(previous: int, seq: int, lost: int) -> None:
    assert lost_between(previous, seq) == lost


def test_unbroken_stream_counts_nothing() -> None:
    numbers = [n & 0xFFFF for n in range(70_000)]
    assert sum(lost_between(*pair) for pair in pairwise(numbers)) == 0


@repeatable
@given(st.integers(0, 65_535), st.lists(st.integers(0, 1000), min_size=1, max_size=50))
def test_all_losses_are_counted(start: int, losses: list[int]) -> None:
    seq = start
    for lost in losses:
        before = seq
        seq = (seq + 1 + lost) & 0xFFFF
        assert lost_between(before, seq) == lost
