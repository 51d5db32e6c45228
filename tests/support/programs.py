"""Programs of the system that tests run.

`make test` installs them if it may. Otherwise their tests are skipped and name the package to
install; `.ci/run` accepts no skipped test (conftest.py).
"""

import atexit
import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import pytest

REMEDY = "install it with `make deps`"


def program(name: str) -> str:
    """Path of a program, or the test is skipped."""
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is missing; {REMEDY}")
    return found


def compiler() -> list[str]:
    """Return the command of the C compiler: $CC, else cc, else gcc; or skip the test."""
    for command in (os.environ.get("CC", ""), "cc", "gcc"):
        words = shlex.split(command)
        if words and shutil.which(words[0]):
            return words
    pytest.skip(f"no C compiler ($CC, cc or gcc); {REMEDY}")


def octave_with_signal() -> str:
    """Path of octave-cli that has octave-signal, or the test is skipped."""
    octave = program("octave-cli")
    command = [octave, "--norc", "--eval", "pkg load signal"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)
    if done.returncode:
        pytest.skip(f"octave-signal is missing; {REMEDY}")
    return octave


def build_library(sources: Sequence[Path], flags: Sequence[str]) -> Path:
    """Compile C `sources` into a shared library in a folder that ends with this process."""
    folder = tempfile.mkdtemp(prefix="hapticd-c-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    library = Path(folder) / "library.so"
    command = [*compiler(), *flags, "-shared", "-fPIC", *map(str, sources), "-o", str(library)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return library
