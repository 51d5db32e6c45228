"""What the firmware of the Pico sends to its DACs: the nearest code for every count of the wire,
saturated, in the words of the parts' data sheets. The very source is compiled on this machine.
"""

import ctypes
from ctypes import POINTER, c_bool, c_int16, c_uint8, c_uint16, c_uint32
from functools import cache

import pytest
from support.firmware_build import WARNINGS
from support.programs import build_library

from firmware_iface.pico.build import SOURCES

TORQUES = range(-32768, 32768)
DAMPINGS = range(65536)
DAC8563, MCP4922, DAC8812 = range(3)


class Part(ctypes.Structure):
    """struct dac_part."""

    _fields_ = (
        ("bits", c_uint8),
        ("bytes", c_uint8),
        ("spi_mode", c_uint8),
        ("damping_upper_half", c_bool),
        ("torque_word", c_uint32),
        ("damping_word", c_uint32),
        ("resistance_word", c_uint32),
        ("start_word", c_uint32),
    )


@cache
def library() -> ctypes.CDLL:
    found = ctypes.CDLL(str(build_library([SOURCES / "dac_parts.c"], [*WARNINGS, "-O2"])))
    for name, count in (("torque", c_int16), ("damping", c_uint16), ("resistance", c_int16)):
        function = getattr(found, f"dac_{name}_word")
        function.argtypes = [POINTER(Part), count]
        function.restype = c_uint32
    return found


def part(index: int) -> Part:
    return (Part * 3).in_dll(library(), "dac_parts")[index]


def torque_word(index: int, count: int) -> int:
    return library().dac_torque_word(part(index), count)


def damping_word(index: int, count: int) -> int:
    return library().dac_damping_word(part(index), count)


def resistance_word(index: int, count: int) -> int:
    return library().dac_resistance_word(part(index), count)


def nearest(numerator: int, denominator: int, highest: int) -> int:
    """The integer nearest to the fraction, the upper one of two, and no more than `highest`."""
    return min((2 * numerator + denominator) // (2 * denominator), highest)


# --- every count of the wire ----------------------------------------------------------------------


@pytest.mark.parametrize(("index", "bits"), [(DAC8563, 16), (MCP4922, 12)])
def test_torque_is_the_nearest_code_around_mid_scale(index: int, bits: int) -> None:
    codes = 1 << bits
    found = [torque_word(index, count) % codes for count in TORQUES]
    assert found == [nearest((count + 32768) * codes, 65536, codes - 1) for count in TORQUES]


def test_damping_of_the_mcp4922_is_the_nearest_of_all_its_codes() -> None:
    found = [damping_word(MCP4922, count) % 4096 for count in DAMPINGS]
    assert found == [nearest(count * 4096, 65536, 4095) for count in DAMPINGS]


def test_damping_of_the_dac8563_is_the_nearest_code_of_its_upper_half() -> None:
    found = [damping_word(DAC8563, count) % 65536 for count in DAMPINGS]
    assert found == [32768 + nearest(count * 32768, 65536, 32767) for count in DAMPINGS]


@pytest.mark.parametrize("index", [DAC8563, MCP4922])
def test_command_and_channel_are_the_same_for_every_count(index: int) -> None:
    data = (1 << part(index).bits) - 1
    torque = {torque_word(index, count) & ~data for count in TORQUES}
    damping = {damping_word(index, count) & ~data for count in DAMPINGS}
    assert torque == {part(index).torque_word}
    assert damping == {part(index).damping_word}


def test_damping_of_the_dac8812_is_its_code() -> None:
    assert [damping_word(DAC8812, count) % 65536 for count in DAMPINGS] == list(DAMPINGS)


def test_trim_of_the_dac8812_is_twice_its_count_and_never_below_0() -> None:
    found = [resistance_word(DAC8812, count) % 65536 for count in TORQUES]
    assert found == [max(0, 2 * count) for count in TORQUES]


def test_channels_of_the_dac8812_are_the_same_for_every_count() -> None:
    assert {damping_word(DAC8812, count) >> 16 for count in DAMPINGS} == {0b01}
    assert {resistance_word(DAC8812, count) >> 16 for count in TORQUES} == {0b10}


# --- the data sheets ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("count", "word"),
    [(0, 0x188000), (1, 0x188001), (-1, 0x187FFF), (32767, 0x18FFFF), (-32768, 0x180000)],
)
def test_torque_word_of_the_dac8563(count: int, word: int) -> None:
    """24 bits: two ignored, command 011 (write and update), address 000 (A), 16 of data."""
    assert torque_word(DAC8563, count) == word


@pytest.mark.parametrize(
    ("count", "word"), [(0, 0x198000), (1, 0x198001), (2, 0x198001), (65535, 0x19FFFF)]
)
def test_damping_word_of_the_dac8563(count: int, word: int) -> None:
    """Address 001 (B); no damping is mid-scale, where the part powers up."""
    assert damping_word(DAC8563, count) == word


def test_dac8563_is_framed_and_started_as_its_data_sheet_says() -> None:
    """Data are taken at the falling edge: polarity 0, phase 1. Command 111 with 1 turns the
    internal reference on and sets both gains to 2.
    """
    found = part(DAC8563)
    assert (found.bits, found.bytes, found.spi_mode) == (16, 3, 0b01)
    assert found.start_word >> 19 == 0b111
    assert found.start_word & 0xFFFF == 1


@pytest.mark.parametrize(
    ("count", "word"),
    [
        (0, 0x7800), (7, 0x7800), (8, 0x7801), (-8, 0x7800), (-9, 0x77FF),
        (32767, 0x7FFF), (32751, 0x7FFF), (-32768, 0x7000),
    ],
)  # fmt: skip
def test_torque_word_of_the_mcp4922(count: int, word: int) -> None:
    """16 bits: A, buffered reference, gain 1, active, 12 of data."""
    assert torque_word(MCP4922, count) == word


@pytest.mark.parametrize(
    ("count", "word"), [(0, 0xF000), (7, 0xF000), (8, 0xF001), (32768, 0xF800), (65535, 0xFFFF)]
)
def test_damping_word_of_the_mcp4922(count: int, word: int) -> None:
    """B, buffered reference, gain 1, active."""
    assert damping_word(MCP4922, count) == word


def test_mcp4922_is_framed_as_its_data_sheet_says() -> None:
    """Data are taken at the rising edge: polarity 0, phase 0. It needs no start word."""
    found = part(MCP4922)
    assert (found.bits, found.bytes, found.spi_mode, found.start_word) == (12, 2, 0b00, 0)


@pytest.mark.parametrize(("count", "word"), [(0, 0x10000), (1, 0x10001), (65535, 0x1FFFF)])
def test_damping_word_of_the_dac8812(count: int, word: int) -> None:
    """Of 24 bits the last 18 count: address 01 (A), 16 of data. 0 is where the part powers up."""
    assert damping_word(DAC8812, count) == word


@pytest.mark.parametrize(
    ("count", "word"), [(0, 0x20000), (1, 0x20002), (-1, 0x20000), (32767, 0x2FFFE)]
)
def test_resistance_word_of_the_dac8812(count: int, word: int) -> None:
    """Address 10 (B)."""
    assert resistance_word(DAC8812, count) == word


def test_dac8812_is_framed_as_its_data_sheet_says() -> None:
    """Data are taken at the rising edge: polarity 0, phase 0. It makes no torque."""
    found = part(DAC8812)
    assert (found.bits, found.bytes, found.spi_mode) == (16, 3, 0b00)
    assert (found.torque_word, found.start_word) == (0, 0)


def test_only_the_dac8812_has_a_channel_for_the_trim() -> None:
    assert [index for index in range(3) if part(index).resistance_word] == [DAC8812]
