"""`python -m firmware_iface.pico.build [FOLDER] [NAME=VALUE ...]`: build the firmware for a
Raspberry Pi Pico, with gcc-arm-none-eabi alone. One version of the compiler gives the same bytes
each time.

FOLDER (default: build/pico) gets hapticd.uf2, .bin (flash from its start), .elf and .map. NAME is a
macro of config.h.
"""

import hashlib
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from firmware_iface.pico.image import uf2, with_checksum

__all__ = ["COMPILER", "SOURCES", "build"]

SOURCES = Path(__file__).resolve().parent
INTERFACE = SOURCES.parent  # hapticd_wire.h
REFERENCE = INTERFACE / "reference"
COMPILER = "arm-none-eabi-gcc"
OBJCOPY = "arm-none-eabi-objcopy"
NAME = "hapticd"

_TARGET = ["-mcpu=cortex-m0plus", "-mthumb", "-std=c99", "-O2", "-ffreestanding"]
_WARNINGS = ["-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wpedantic", "-Werror"]
# loops of memory.c must not become calls of themselves; unused functions are left out
_CODE = ["-fno-tree-loop-distribute-patterns", "-ffunction-sections", "-fdata-sections"]
_LINK = ["-nostdlib", "-Wl,--gc-sections", "-Wl,--fatal-warnings"]


def build(
    folder: Path,
    *,
    defines: Mapping[str, str] | None = None,
    echo: bool = False,
    sources: Path = SOURCES,
) -> Path:
    """Compile and link the firmware into `folder`; return the path of its .uf2.

    `defines` are macros of config.h, e.g. {"DAC_PART": "MCP4922"}. `sources` holds the files of
    this folder, or changed copies of them; the reference firmware is used unchanged. `echo` writes
    each command to stdout. FileNotFoundError without the compiler; subprocess.CalledProcessError,
    with the compiler's text in `stderr`, if it refuses a source.
    """
    folder.mkdir(parents=True, exist_ok=True)
    elf, linked, image = (folder / f"{NAME}.{kind}" for kind in ("elf", "linked", "bin"))
    _run(_compile(folder, sources, defines or {}, elf), echo)
    _run([OBJCOPY, "-O", "binary", str(elf), str(linked)], echo)
    image.write_bytes(with_checksum(linked.read_bytes()))
    linked.unlink()
    blocks = image.with_suffix(".uf2")
    blocks.write_bytes(uf2(image.read_bytes()))
    return blocks


def _compile(folder: Path, sources: Path, defines: Mapping[str, str], elf: Path) -> list[str]:
    includes = [sources / "include", sources, INTERFACE, REFERENCE]
    files = [sources / "boot2.S", *sorted(sources.glob("*.c")), *sorted(REFERENCE.glob("*.c"))]
    return [
        COMPILER,
        *_TARGET,
        *_WARNINGS,
        *_CODE,
        *_LINK,
        *(f"-D{name}={value}" for name, value in sorted(defines.items())),
        *(f"-I{one}" for one in includes),
        f"-T{sources / 'link.ld'}",
        f"-Wl,-Map={folder / NAME}.map",
        *map(str, files),
        "-lgcc",
        "-o",
        str(elf),
    ]


def _run(command: list[str], echo: bool) -> None:
    if echo:
        sys.stdout.write(" ".join(command) + "\n")
    subprocess.run(command, check=True, stderr=subprocess.PIPE, text=True)


def _main(words: list[str]) -> int:
    folders = [word for word in words if "=" not in word]
    defines = dict(word.split("=", 1) for word in words if "=" in word)
    try:
        blocks = build(Path(folders[0] if folders else "build/pico"), defines=defines)
    except FileNotFoundError:
        sys.stderr.write(f"{COMPILER} is missing; install gcc-arm-none-eabi\n")
        return 1
    except subprocess.CalledProcessError as refused:
        sys.stderr.write(refused.stderr)
        return 1
    size = blocks.with_suffix(".bin").stat().st_size
    digest = hashlib.sha256(blocks.read_bytes()).hexdigest()
    sys.stdout.write(f"{blocks}: {size} bytes of flash; sha256 {digest}\n")
    return 0


if __name__ == "__main__":
    sys.exit(_main(sys.argv[1:]))
