"""The machine as the checks see it, and the requirements of the configuration.

The machine consists of files below a root, and facts about this process that are in no file:
rights, limits, groups, free space, the interpreter.
"""

import grp
import gzip
import os
import platform
import resource
import shutil
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from hapticd.core.params import RealtimeParams, UsbParams
from hapticd.mailbox.daemons import untrusted_daemon_folder
from hapticd.mailbox.files import DEFAULT_INSTANCE
from hapticd.settings.build import gateway_params, servo_params
from hapticd.settings.load import Settings

__all__ = ["Requirements", "requirements", "this_machine"]

UNLIMITED = resource.RLIM_INFINITY
CAP_IPC_LOCK = 14  # bits of linux/capability.h
CAP_SYS_NICE = 23


class Build(NamedTuple):
    """Build options of the interpreter, from `sysconfig`."""

    version: str
    prefix: str  # of its installation
    options: str  # of configure
    flags: str  # of the compiler
    debug: bool


@dataclass(frozen=True)
class Machine:
    """Files below `root`, and facts about this process. Tests construct one from a few files."""

    root: Path  # below which proc, sys, dev, etc and boot are read
    uid: int  # of this process
    groups: frozenset[str]  # names of its groups
    limits: dict[str, tuple[int, int]]  # (soft, hard) of rtprio, memlock [bytes] and rttime [us]
    capabilities: int  # effective ones, as a bit mask; capabilities(7)
    cores: frozenset[int]  # on which it may run
    clock_resolution_s: float  # of CLOCK_MONOTONIC
    may_write: Callable[[Path], bool]  # whether this user may write a file
    free_bytes: Callable[[Path], int]  # of the disk that a folder is on
    build: Build  # of the interpreter that runs this

    def text(self, path: str) -> str | None:
        """Return the content of a file without surrounding blanks; None if it cannot be read."""
        try:
            return (self.root / path).read_text(errors="replace").strip()
        except OSError:
            return None

    def lines(self, path: str) -> list[str]:
        """Return the lines of a file; none if it cannot be read."""
        return (self.text(path) or "").splitlines()

    def number(self, path: str) -> int | None:
        """Return the first word of a file as an integer; None if there is none."""
        try:
            return int((self.text(path) or "").split()[0])
        except (IndexError, ValueError):
            return None

    def find(self, pattern: str) -> Iterator[Path]:
        """Return the paths below the root that match, in order."""
        return iter(sorted(self.root.glob(pattern)))

    def capable(self, bit: int) -> bool:
        """Return whether this process has the capability."""
        return bool(self.capabilities >> bit & 1)

    def limit(self, name: str) -> float:
        """Return the soft limit; infinity if there is none."""
        return _plain(self.limits[name][0])

    def hard_limit(self, name: str) -> float:
        """Return the hard limit; infinity if there is none."""
        return _plain(self.limits[name][1])

    def kernel_option(self, name: str) -> str:
        """Return CONFIG_<name> of the running kernel: y, m, a number; n when it is not set.

        Empty when no file contains the configuration.
        """
        config = self._kernel_config()
        for line in config.splitlines():
            if line.startswith(f"CONFIG_{name}="):
                return line.partition("=")[2]
        return "n" if config else ""

    def _kernel_config(self) -> str:
        try:
            return gzip.decompress((self.root / "proc/config.gz").read_bytes()).decode()
        except OSError:
            return self.text(f"boot/config-{self.text('proc/sys/kernel/osrelease')}") or ""

    def boot_option(self, name: str) -> str | None:
        """Return the value of `name` on the kernel command line; None if it is absent.

        Empty if it has no value.
        """
        words = (self.text("proc/cmdline") or "").split()
        found = [word.partition("=")[2] for word in words if word.partition("=")[0] == name]
        return found[-1] if found else None


def this_machine() -> Machine:
    """Return the machine of this process."""
    options, flags, debug = sysconfig.get_config_vars("CONFIG_ARGS", "PY_CFLAGS", "Py_DEBUG")
    return Machine(
        root=Path("/"),
        uid=os.getuid(),
        groups=frozenset(filter(None, map(_group_name, {os.getgid(), *os.getgroups()}))),
        limits={name: resource.getrlimit(number) for name, number in _LIMITS.items()},
        capabilities=_effective_capabilities(),
        cores=frozenset(os.sched_getaffinity(0)),
        clock_resolution_s=time.clock_getres(time.CLOCK_MONOTONIC),
        may_write=lambda path: os.access(path, os.W_OK),
        free_bytes=lambda path: shutil.disk_usage(path).free,
        build=Build(
            platform.python_version(), sys.base_prefix, options or "", flags or "", bool(debug)
        ),
    )


# RLIMIT_RTTIME is 15 on every Linux but is missing in the module
_LIMITS = {"rtprio": resource.RLIMIT_RTPRIO, "memlock": resource.RLIMIT_MEMLOCK, "rttime": 15}


def _plain(limit: int) -> float:
    return float("inf") if limit == UNLIMITED else limit


def _group_name(number: int) -> str:
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return ""


def _effective_capabilities() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next((int(line.split()[1], 16) for line in lines if line.startswith("CapEff:")), 0)


def cores_in(text: str) -> frozenset[int]:
    """Parse a list of the kernel: "1,3-5" -> {1, 3, 4, 5}."""
    found: set[int] = set()
    for part in filter(None, text.strip().split(",")):
        first, _, last = part.partition("-")
        found.update(range(int(first), int(last or first) + 1))
    return frozenset(found)


@dataclass(frozen=True)
class Requirements:
    """Requirements of a daemon on its machine."""

    realtime: RealtimeParams  # rate, priority, core and spin of the servo
    usb: UsbParams  # which board
    simulated: bool  # the configured board is simulated
    runtime: Path  # folder of the daemon
    recordings: Path  # folder in which a recording would be written
    keys: Path | None  # folder of CURVE keys; None if telemetry needs none

    @property
    def board(self) -> str:
        """Vendor and product as in lsusb."""
        return f"{self.usb.vendor_id:04x}:{self.usb.product_id:04x}"


def requirements(
    settings: Settings, instance: str = DEFAULT_INSTANCE, recordings: Path | None = None
) -> Requirements:
    """Return the requirements of the daemon `instance` with `settings`.

    Recordings go to the working folder unless `recordings` is another one.
    """
    servo = servo_params(settings, instance)
    keys = gateway_params(settings).curve_keys
    return Requirements(
        realtime=servo.realtime,
        usb=servo.usb,
        simulated=servo.simulated,
        runtime=untrusted_daemon_folder(instance),
        recordings=recordings or Path.cwd(),
        keys=Path(keys) if keys else None,
    )
