"""How the interpreter was built: the tick is Python, so its time is the interpreter's.

CPython's own Makefile optimises for a measured profile only with `--enable-optimizations`. A build
without it, as pyenv makes one by default, takes longer for the same tick. `sysconfig` has the
options of configure. Distributions pass theirs in other ways and show none, so of an interpreter
below /usr nothing is concluded.
"""

import platform
import re
import sys
import sysconfig
from typing import NamedTuple

from hapticd.run.doctor.checks import CheckResult, ok, warn

__all__ = ["judge", "this_build"]

NAME = "interpreter"
DISTRIBUTION = "/usr"  # the prefix of its interpreter
COSTS = "a tick takes a tenth to a fifth longer, measured against Debian's build of 3.11"
FIX = (
    "run hapticd with the distribution's python3 or with one of `uv python install`; or build with"
    " --enable-optimizations --with-lto"
)


class Build(NamedTuple):
    """What is known of how the interpreter was built."""

    version: str
    prefix: str  # of its installation
    options: str  # of configure
    flags: str  # of the compiler
    debug: bool


def this_build() -> Build:
    """The interpreter that runs."""
    options, flags, debug = sysconfig.get_config_vars("CONFIG_ARGS", "PY_CFLAGS", "Py_DEBUG")
    return Build(
        platform.python_version(), sys.base_prefix, options or "", flags or "", bool(debug)
    )


def judge(build: Build) -> CheckResult:
    """The interpreter as a line."""
    levels = re.findall(r"-O(?:[0-3gsz]|fast)\b", build.flags)
    level = levels[-1] if levels else "an unknown -O level"
    found = f"Python {build.version}"
    if build.debug or level in ("-O0", "-Og"):
        why = "an interpreter for debugging is several times slower"
        return warn(NAME, f"{found}, for debugging ({level})", why, FIX)
    if "--enable-optimizations" in build.options:
        linked = " and link-time" if "--with-lto" in build.options else ""
        return ok(NAME, f"{found}, profile-guided{linked} optimisation, {level}")
    if build.prefix == DISTRIBUTION:
        return ok(NAME, f"{found} of the distribution, {level}")
    return warn(NAME, f"{found} without profile-guided optimisation, {level}", COSTS, FIX)
