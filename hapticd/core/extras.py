"""Optional libraries: imported where a verb needs one; a missing one is named with its remedy.

The requirement is that of the installed distribution's metadata, so pyproject.toml alone states
it. The command installs into the environment that runs: `make lab` in a checkout's own .venv, else
pip or uv by the path of its interpreter. hapticd itself is on no index, so no command names it.
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

__all__ = ["install_command", "need", "requirement", "requirements"]

CHECKOUT = Path(__file__).resolve().parents[1]
LAB = {"numba", "matplotlib"}  # what `make lab` adds


def need(module: str, purpose: str) -> Any:
    """Import `module`.

    MissingLibrary: it is not installed; `purpose` says what needs it.
    """
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        wanted, command = requirement(library), install_command(library)
        message = f"{purpose} needs {wanted}, which is not installed; type: {command}"
        raise MissingLibrary(message, wanted, command) from error


def requirements() -> list[str]:
    """What hapticd takes, as its metadata has it; nothing where a folder runs that is not
    installed.
    """
    with suppress(PackageNotFoundError):
        return requires("hapticd") or []
    return []


def requirement(library: str) -> str:
    """The name of `library` with the versions that hapticd takes, as pip reads it."""
    for line in requirements():
        stated = line.partition(";")[0].strip()
        if re.match(r"[\w.-]+", stated)[0].replace("-", "_") == library:  # type: ignore[index]  # never empty
            return stated
    return library


def install_command(library: str) -> str:
    """The shell command that installs `library` into the environment that runs."""
    if library in LAB and Path(sys.prefix) == CHECKOUT / ".venv":
        return f"make -C {shlex.quote(str(CHECKOUT))} lab"
    wanted = shlex.quote(requirement(library))
    python = shlex.quote(sys.executable)
    if find_spec("pip") is None:  # an environment that uv made
        return f"uv pip install --python {python} {wanted}"
    return f"{python} -m pip install {wanted}"
