"""The compiled reference firmware: as a library for a simulation, as a sanitised fuzzer, and with a
coverage count.

`folder` holds the sources to build, all *.c in it: the reference or a modified copy.
"""

import ctypes
import re
import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

from support import wire_header
from support.programs import build_library, compiler, program

REFERENCE = wire_header.FOLDER / "reference"
SHIM = Path(__file__).with_name("firmware_shim.c")
FUZZER = Path(__file__).with_name("firmware_fuzz.c")
WARNINGS = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wpedantic", "-Werror"]
# the trap needs no library of the sanitizer in the process that loads it
TRAP = ["-fsanitize=undefined", "-fsanitize-undefined-trap-on-error"]
SANITIZED = ["-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
COVERED = ["-O0", "--coverage"]


class Reached(NamedTuple):
    """The coverage of one source in a run."""

    lines_percent: float
    branches: int
    missed: int  # branches without a hit


def sources(folder: Path) -> list[Path]:
    """The C files of a firmware."""
    return sorted(folder.glob("*.c"))


@cache
def load_firmware(folder: Path = REFERENCE) -> ctypes.CDLL:
    """The firmware of `folder` as a library, every warning an error, undefined behaviour a trap."""
    flags = [*WARNINGS, *TRAP, "-O2", *_includes(folder)]
    library = ctypes.CDLL(str(build_library([*sources(folder), SHIM], flags)))
    library.hapticd_board_wait_us.restype = ctypes.c_uint32
    for name in ("hapticd_board_boot", "hapticd_board_out", "hapticd_latch_due"):
        getattr(library, name).restype = ctypes.c_bool
    return library


def fuzz(built: Path, steps: int, flags: Sequence[str], folder: Path = REFERENCE) -> str:
    """Build the fuzzer in the folder `built`, run it there and return its report. AssertionError
    with its message if a promise was broken.
    """
    files = [str(one) for one in (FUZZER, *sources(folder))]
    command = [*compiler(), *WARNINGS, *flags, *_includes(folder), *files, "-o", "fuzz"]
    said = ""
    for words in (command, ["./fuzz", str(steps)]):
        done = subprocess.run(words, capture_output=True, text=True, cwd=built, check=False)
        assert done.returncode == 0, done.stderr
        said = done.stdout
    return said.strip()


def reached(built: Path, folder: Path = REFERENCE) -> dict[str, Reached]:
    """Return the coverage of each source by the fuzzer, built in `built` with COVERED."""
    return {one.name: _reached(built, one.name) for one in sources(folder)}


def _reached(built: Path, source: str) -> Reached:
    command = [program("gcov"), "-b", f"fuzz-{Path(source).stem}.gcda"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=built, check=True)
    report = done.stdout.partition(source)[2]
    numbers = r"Lines executed:([\d.]+)%.*?least once:([\d.]+)% of (\d+)"
    found = re.search(numbers, report, re.DOTALL)
    assert found is not None
    lines, taken, branches = map(float, found.groups())
    return Reached(lines, int(branches), round(branches * (1.0 - taken / 100.0)))


def _includes(folder: Path) -> list[str]:
    return [f"-I{wire_header.FOLDER}", f"-I{folder}"]
