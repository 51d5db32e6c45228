"""The node modules for the emulator of the chip. They are installed once by the lock file of
tests/acceptance/pico, which has their hashes, and cached under the hash of that file.
"""

import hashlib
import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

from support.kept import alone, cache_folder
from support.tree import TESTS

EMULATOR = TESTS / "acceptance" / "pico"
PACKAGES = ("package.json", "package-lock.json")
INSTALL = ("npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund")
REMEDY = "sudo apt-get install -y --no-install-recommends nodejs npm gcc-arm-none-eabi"
OLDEST_NODE = 18


@cache
def modules() -> Path:
    """Return the folder with node_modules: $HAPTICD_NODE_MODULES, or one that a single process at a
    time creates. AssertionError with the output of a failed command.
    """
    given = os.environ.get("HAPTICD_NODE_MODULES")
    if given:
        return Path(given)
    digest = hashlib.sha256(b"".join((EMULATOR / name).read_bytes() for name in PACKAGES))
    folder = cache_folder() / f"pico-{digest.hexdigest()[:12]}"
    folder.parent.mkdir(parents=True, exist_ok=True)
    with alone(folder.with_suffix(".lock")):
        if not folder.exists():
            with tempfile.TemporaryDirectory(prefix="pico-", dir=folder.parent) as made:
                _install(Path(made) / "made").rename(folder)
    return folder


def _install(folder: Path) -> Path:
    folder.mkdir()
    for name in PACKAGES:
        shutil.copy(EMULATOR / name, folder)
    words = [needed(INSTALL[0]), *INSTALL[1:]]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(INSTALL)}:\n{done.stdout}{done.stderr}"
    return folder


def needed(name: str) -> str:
    """Path of a program. AssertionError with the line to type where it is missing."""
    found = shutil.which(name)
    assert found, f"{name} is missing; type:  {REMEDY}"
    return found


@cache
def node() -> str:
    """Path of a node that is new enough. AssertionError with the line to type."""
    found = needed("node")
    told = subprocess.run([found, "--version"], capture_output=True, text=True, check=True).stdout
    version = int(told.lstrip("v").partition(".")[0])
    assert version >= OLDEST_NODE, f"node {told.strip()}: {OLDEST_NODE} or newer; {REMEDY}"
    return found


if __name__ == "__main__":
    print(modules())
