"""A Linux kernel with a USB stack that runs as an ordinary process: user-mode Linux, built from the
kernel source of this machine's distribution and cached by version and configuration.

The distribution's own user-mode kernel has no USB. The build takes two to three minutes on two
cores; the cached result is one static program of a few megabytes.
"""

import hashlib
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

from support.kept import alone, cache_folder

CONFIG = Path(__file__).with_name("usb_guest") / "kernel.config"
SOURCES = Path("/usr/src")
PACKAGE = "linux-source"  # `.ci/deps test` installs it
NOT_UNPACKED = "drivers/gpu/drm/amd/include"  # 0.4 of 1.3 GB, not used
# 6.1 reserves 2696 bytes for the registers of ptrace; a processor with AMX has 11008, and the
# kernel of the machine refuses less than that ("ptrace set fp regs failed, errno = 14")
REGISTERS = Path("arch/x86/um/user-offsets.c")
TOO_FEW = "DEFINE_LONGS(HOST_FP_SIZE, 2696)"
ENOUGH = "DEFINE_LONGS(HOST_FP_SIZE, 16384)"
JOBS = 2


def kernel() -> Path:
    """Return the kernel; build it if it is missing, in one process at a time. AssertionError with
    the output of a failed command.
    """
    source = _source()
    folder = cache_folder() / f"uml-{source.name.removesuffix('.tar.xz')}-{_key(source)}"
    kept = folder / "linux"
    folder.parent.mkdir(parents=True, exist_ok=True)
    with alone(folder.with_suffix(".lock")):
        if kept.exists():
            return kept
        with tempfile.TemporaryDirectory(prefix="uml-", dir=folder.parent) as build:
            made = _build(source, Path(build))
            folder.mkdir(exist_ok=True)
            made.rename(kept)
    return kept


def _source() -> Path:
    """The newest kernel source that is installed."""
    found = sorted(SOURCES.glob("linux-source-*.tar.xz"), key=_version)
    assert found, f"no {SOURCES}/linux-source-*.tar.xz: apt-get install {PACKAGE}"
    return found[-1]


def _version(source: Path) -> tuple[int, ...]:
    return tuple(int(part) for part in source.name.split("-")[2].split(".") if part.isdecimal())


def _key(source: Path) -> str:
    """Return the key of the source package's bytes, which change with every release, and of the
    build.
    """
    digest = hashlib.sha256(f"{source.name} {source.stat().st_size} {ENOUGH}".encode())
    digest.update(CONFIG.read_bytes())
    return digest.hexdigest()[:12]


def _build(source: Path, folder: Path) -> Path:
    _run(["tar", "-xf", str(source), f"--exclude=*/{NOT_UNPACKED}"], folder)
    (tree,) = folder.iterdir()
    registers = tree / REGISTERS
    registers.write_text(registers.read_text().replace(TOO_FEW, ENOUGH))
    make = ["make", "-s", "ARCH=um"]
    _run([*make, "tinyconfig"], tree)
    _run(["scripts/kconfig/merge_config.sh", "-m", ".config", str(CONFIG)], tree)
    _run([*make, "olddefconfig"], tree)
    _run([*make, f"-j{JOBS}", "linux"], tree)
    _run(["strip", "linux"], tree)
    return tree / "linux"


def _run(words: Sequence[str], folder: Path) -> None:
    assert shutil.which(words[0]) or (folder / words[0]).exists(), f"{words[0]} is missing"
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(words)}:\n{done.stdout[-4000:]}{done.stderr[-4000:]}"


if __name__ == "__main__":
    print(kernel())
