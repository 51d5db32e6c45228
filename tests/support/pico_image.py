"""The firmware of the Pico from its build: bytes, symbols, words at addresses."""

import atexit
import re
import shutil
import struct
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from typing import NamedTuple

from firmware_iface.pico.build import COMPILER, build
from hapticd.usb.codec import decode_hello
from hapticd.usb.frames import HELLO_BYTES, PROTOCOL_HASH, HelloFrame
from support.programs import program

SERIAL = "E66118604B3A5C2F"  # of a flash chip
FLASH = range(0x10000000, 0x10000000 + 2 * 1024 * 1024)
RAM = range(0x20000000, 0x20000000 + 256 * 1024)
Defines = tuple[tuple[str, str], ...]  # macros of config.h


class Symbol(NamedTuple):
    """A line of nm."""

    address: int
    kind: str  # nm's letter
    size: int


class Block(NamedTuple):
    """A UF2 block, without the data behind the first `size` bytes."""

    magic: tuple[int, int, int]
    flags: int
    address: int
    size: int
    number: int
    blocks: int
    family: int
    data: bytes


@cache
def built(defines: Defines = ()) -> Path:
    """The folder with the firmware of this checkout, built once in this process with these macros.
    The test is skipped without the compiler.
    """
    program(COMPILER)
    folder = Path(tempfile.mkdtemp(prefix="hapticd-pico-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    build(folder, defines=dict(defines))
    return folder


def blocks(path: Path) -> list[Block]:
    """The blocks of a .uf2."""
    file = path.read_bytes()
    assert len(file) % 512 == 0
    return [_block(file[at : at + 512]) for at in range(0, len(file), 512)]


def _block(raw: bytes) -> Block:
    first, second, flags, address, size, number, count, family = struct.unpack_from("<8I", raw)
    (last,) = struct.unpack_from("<I", raw, 508)
    data = raw[32 : 32 + size]
    return Block((first, second, last), flags, address, size, number, count, family, data)


@cache
def symbols(defines: Defines = ()) -> dict[str, Symbol]:
    """Return the symbols of the linked firmware."""
    words = ["arm-none-eabi-nm", "--print-size", str(built(defines) / "hapticd.elf")]
    text = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    found = {}
    for line in text.splitlines():
        *numbers, kind, name = line.split()
        address, size = ([int(one, 16) for one in numbers] + [0, 0])[:2]
        found[name] = Symbol(address, kind, size)
    return found


def words_at(address: int, count: int, defines: Defines = ()) -> tuple[int, ...]:
    """32-bit words as they are after start-up has copied the program to RAM."""
    image = (built(defines) / "hapticd.bin").read_bytes()
    known = symbols(defines)
    offset = address - FLASH.start
    if address in RAM:
        assert address < known["__ram_end"].address
        offset = known["__ram_load"].address - FLASH.start + address - known["__ram_start"].address
    return struct.unpack_from(f"<{count}I", image, offset)


def program_words() -> tuple[int, ...]:
    """The PIO program of the encoder, from its start at address 0."""
    symbol = symbols()["program"]
    words = words_at(symbol.address, (symbol.size + 3) // 4)
    halves = [half for word in words for half in (word & 0xFFFF, word >> 16)]
    return tuple(halves[: symbol.size // 2])


def hello(defines: Defines = ()) -> HelloFrame:
    """Return HELLO of the image, with the fields of start-up: a hash and a serial number."""
    known = symbols(defines)
    (name,) = [one for one in known if re.fullmatch(r"config\.\d+", one)]
    words = words_at(known[name].address, HELLO_BYTES // 4, defines)
    raw = bytearray(struct.pack(f"<{len(words)}I", *words))
    raw[: len(PROTOCOL_HASH)] = PROTOCOL_HASH
    raw[16:32] = SERIAL.encode()
    return decode_hello(bytes(raw))
