"""The firmware of the Pico is built from its sources and libgcc alone, the same each time, into a
file that the chip takes.
"""

import re
import shutil
import subprocess
import zlib
from pathlib import Path

import pytest
from support.pico_image import FLASH, RAM, blocks, built, symbols, words_at
from support.tree import ROOT

from firmware_iface.pico.build import SOURCES, build

STACK_TOP = RAM.stop
BOOT_BYTES = 252
HANDLERS = {16: "timer_irq", 16 + 5: "usb_irq", 16 + 13: "io_irq"}
REFERENCE = ROOT / "firmware_iface" / "reference"
PORT = ["clock_us", "inputs", "sense", "measure_pair", "set_torque"]
PORT += ["set_perturbation", "set_damping", "set_resistance", "send"]
CONFIGURATIONS: list[dict[str, str]] = [
    {},
    {"DAC_PART": "MCP4922"},
    {"DAMPING_PART": "DAC8563"},
    {"DAC_PART": "MCP4922", "DAMPING_PART": "MCP4922"},
]
# GPIO to the pin of the Pico's board, from its pinout
BOARD_PIN = {2: 4, 3: 5, 4: 6, 11: 15, 16: 21, 17: 22, 18: 24, 19: 25, 20: 26, 21: 27, 22: 29}


@pytest.fixture(scope="module")
def folder() -> Path:
    return built()


def reversed_bits(value: int, width: int) -> int:
    return int(f"{value:0{width}b}"[::-1], 2)


def boot_rom_checksum(data: bytes) -> int:
    """By zlib's CRC-32, which differs in the order of bits and an inversion at the end."""
    mirrored = bytes(reversed_bits(one, 8) for one in data)
    return reversed_bits(zlib.crc32(mirrored) ^ 0xFFFFFFFF, 32)


def thumb(name: str) -> int:
    """What a pointer to that function holds."""
    return symbols()[name].address | 1


# --- the same each time ---------------------------------------------------------------------------


@pytest.mark.parametrize("defines", CONFIGURATIONS, ids=str)
def test_copy_of_the_sources_built_elsewhere_gives_the_same_bytes(
    defines: dict[str, str], tmp_path: Path
) -> None:
    copy = tmp_path / "another place"
    shutil.copytree(SOURCES, copy, ignore=shutil.ignore_patterns("__pycache__"))
    once = build(tmp_path / "once", defines=defines)
    again = build(tmp_path / "out", sources=copy, defines=defines)
    for kind in (".uf2", ".bin"):
        assert again.with_suffix(kind).read_bytes() == once.with_suffix(kind).read_bytes()


def test_shipped_configuration_is_for_the_circuit(folder: Path, tmp_path: Path) -> None:
    named = build(tmp_path, defines={"DAC_PART": "DAC8563", "DAMPING_PART": "DAC8812"})
    assert named.read_bytes() == (folder / "hapticd.uf2").read_bytes()


@pytest.mark.parametrize("defines", [{"DAC_PART": "DAC8812"}, {"DAMPING_PART": "MCP4922"}], ids=str)
def test_parts_that_do_not_go_together_are_refused(defines: dict[str, str], tmp_path: Path) -> None:
    with pytest.raises(subprocess.CalledProcessError) as refused:
        build(tmp_path, defines=defines)
    assert "dac.c" in refused.value.stderr


def test_source_with_a_warning_is_refused(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "sources"
    shutil.copytree(SOURCES, copy)
    events = copy / "events.c"
    events.write_text(events.read_text() + "\nint narrowed(long long wide) { return wide; }\n")
    with pytest.raises(subprocess.CalledProcessError) as refused:
        build(tmp_path / "out", sources=copy)
    assert "-Werror" in refused.value.stderr


# --- the files ------------------------------------------------------------------------------------


def test_boot_stage_carries_the_checksum_of_the_boot_rom(folder: Path) -> None:
    assert boot_rom_checksum(b"123456789") == 0x0376E6E7  # the check of CRC-32/MPEG-2
    image = (folder / "hapticd.bin").read_bytes()
    kept = int.from_bytes(image[BOOT_BYTES : BOOT_BYTES + 4], "little")
    assert kept == boot_rom_checksum(image[:BOOT_BYTES])


def test_uf2_holds_the_image_in_pages_of_flash(folder: Path) -> None:
    found = blocks(folder / "hapticd.uf2")
    image = (folder / "hapticd.bin").read_bytes()
    for number, block in enumerate(found):
        assert block.magic == (0x0A324655, 0x9E5D5157, 0x0AB16F30)
        assert block.flags == 0x2000  # the family is given
        assert block.family == 0xE48BFF56  # RP2040
        assert (block.number, block.blocks, block.size) == (number, len(found), 256)
        assert block.address == FLASH.start + 256 * number
    assert b"".join(block.data for block in found).rstrip(b"\0") == image.rstrip(b"\0")
    assert 0 <= 256 * len(found) - len(image) < 256


# --- the program ----------------------------------------------------------------------------------


def test_nothing_but_libgcc_is_linked(folder: Path) -> None:
    text = (folder / "hapticd.map").read_text()
    assert not [name for name, symbol in symbols().items() if symbol.kind in "Uw"]
    loaded = [Path(one) for one in re.findall(r"^LOAD (/.*)$", text, re.MULTILINE)]
    assert {one.name for one in loaded if one.suffix != ".o"} == {"libgcc.a"}
    sources = [*SOURCES.glob("*.c"), *SOURCES.glob("*.S"), *REFERENCE.glob("*.c")]
    assert len([one for one in loaded if one.suffix == ".o"]) == len(sources)


def test_chip_starts_in_flash_with_its_stack_at_the_end_of_ram() -> None:
    stack, reset = words_at(FLASH.start + 0x100, 2)
    assert stack == STACK_TOP
    assert reset == thumb("reset")
    assert reset in FLASH


def test_each_vector_leads_to_its_handler_in_ram() -> None:
    stack, reset, *others = words_at(symbols()["vectors"].address, 48)
    assert (stack, reset) == (STACK_TOP, thumb("reset"))
    for number, vector in enumerate(others, 2):
        assert vector == thumb(HANDLERS.get(number, "unexpected")), number
        assert vector in RAM
    assert symbols()["vectors"].address % 256 == 0  # VTOR has no lower bits


def test_each_port_function_is_the_one_of_its_name_in_ram() -> None:
    device, *functions = words_at(symbols()["port"].address, 10)
    assert device == 0
    assert functions == [thumb(name) for name in PORT]
    assert all(one in RAM for one in functions)


def test_only_boot_stage_and_copier_run_in_flash() -> None:
    code = {name for name, one in symbols().items() if one.kind in "tT" and one.address in FLASH}
    assert code == {"boot2", "start", "first_vectors", "reset", "__main_veneer"}


def test_stack_has_room_above_the_data() -> None:
    assert STACK_TOP - symbols()["__bss_end"].address > 128 * 1024


# --- the page -------------------------------------------------------------------------------------


def test_wiring_table_has_every_pin_of_the_firmware() -> None:
    header = (SOURCES / "pins.h").read_text()
    pins = {name: int(n) for name, n in re.findall(r"#define PIN_(\w+) (\d+)", header)}
    events = range(pins["EVENT_FIRST"], pins["EVENT_FIRST"] + pins.pop("EVENT_COUNT"))
    page = (ROOT / "docs" / "pico.md").read_text()
    rows = re.findall(r"^\| GPIO (\d+)(?: to (\d+))? \| ([\d to]+|LED) \| `PIN_(\w+)` ", page, re.M)
    assert {name: int(first) for first, _, _, name in rows} == pins
    for first, last, board, _name in rows:
        if board != "LED":
            ends = [BOARD_PIN[int(one)] for one in (first, last) if one]
            assert board == " to ".join(map(str, ends))
        assert not last or range(int(first), int(last) + 1) == events
