"""Optional libraries: imported by the commands that need them; a missing one is reported with its
remedy.

The requirement comes from the metadata of the installed distribution, so only pyproject.toml states
it. The command installs into the running environment: `make lab` in a checkout's own .venv,
otherwise pip or uv by the path of its interpreter. hapticd itself is not on a package index, so no
command contains it.
"""

import re
import shlex
import sys
from contextlib import suppress
from importlib import import_module
from importlib.metadata import PackageNotFoundError, requires
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from hapticd.core.errors import MissingLibrary

__all__ = ["need", "requirements"]

CHECKOUT = Path(__file__).resolve().parents[1]
LAB = {"numba", "matplotlib"}  # installed by `make lab`


def need(module: str, purpose: str) -> Any:
    """Import `module`.

    MissingLibrary: it is not installed; `purpose` is the feature that needs it.
    """
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        wanted, command = requirement(library), install_command(library)
        message = f"{purpose} needs {wanted}, which is not installed; type: {command}"
        raise MissingLibrary(message, wanted, command) from error


def requirements() -> list[str]:
    """Return the requirements of hapticd in its metadata; [] if it runs from a folder without being
    installed.
    """
    with suppress(PackageNotFoundError):
        return requires("hapticd") or []
    return []


def requirement(library: str) -> str:
    """Return the name of `library` with the versions that hapticd accepts, in pip's syntax."""
    for line in requirements():
        stated = line.partition(";")[0].strip()
        if re.match(r"[\w.-]+", stated)[0].replace("-", "_") == library:  # type: ignore[index]  # never empty
            return stated
    return library


def install_command(library: str) -> str:
    """Return the shell command that installs `library` into the running environment."""
    if library in LAB and Path(sys.prefix) == CHECKOUT / ".venv":
        return f"make -C {shlex.quote(str(CHECKOUT))} lab"
    wanted = shlex.quote(requirement(library))
    python = shlex.quote(sys.executable)
    if find_spec("pip") is None:  # an environment created by uv
        return f"uv pip install --python {python} {wanted}"
    return f"{python} -m pip install {wanted}"
