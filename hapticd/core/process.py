"""Common behaviour of every hapticd process: its end, and its notifications to systemd.

A process ends with its parent, and on SIGINT and SIGTERM alike. systemd receives one datagram on
the socket that it provides; without systemd nothing is sent.

Signals must be handled in the main thread: Python runs handlers there.
"""

import ctypes
import os
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hapticd.core.units import NS_PER_US, Clock

if TYPE_CHECKING:
    import subprocess

__all__ = ["Feeder", "die_with_parent", "feeding_period_ns", "launch", "notify", "on_stop"]

_PR_SET_PDEATHSIG = 1  # of <linux/prctl.h>


def die_with_parent(parent_pid: int | None) -> None:
    """Let the kernel send SIGTERM when the parent ends; end at once if it has already ended.

    None: a process without a parent to follow.
    """
    if parent_pid is None:
        return
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent_pid:  # it ended before the call
        os.kill(os.getpid(), signal.SIGTERM)


def launch(*words: str, keep: Sequence[int] = ()) -> "subprocess.Popen[bytes]":
    """Start `python -m words` in a new interpreter, which inherits the descriptors `keep`. Its
    output goes to this process's stderr; it is isolated if this process is.
    """
    import subprocess  # a servo starts no process

    return subprocess.Popen(
        [sys.executable, "-X", "utf8", "-I" if sys.flags.isolated else "-P", "-m", *words],
        stdin=subprocess.DEVNULL,
        stdout=2,
        pass_fds=keep,
        env={**os.environ, **_import_path(), "OPENBLAS_NUM_THREADS": "1"},
        process_group=0,
    )


def _import_path() -> dict[str, str]:
    """Return PYTHONPATH for a child; empty for an installed package. -P keeps the working folder
    out of its imports, so the path of an uninstalled checkout must be given.
    """
    root = Path(__file__).parents[2]
    if root.name in ("site-packages", "dist-packages"):
        return {}
    return {"PYTHONPATH": os.pathsep.join(filter(None, (str(root), os.environ.get("PYTHONPATH"))))}


def on_stop(handler: Callable[[], None]) -> None:
    """Call `handler` on SIGINT and SIGTERM, also in a background job that ignores SIGINT."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda _signal, _frame: handler())


def notify(*lines: str) -> None:
    """Send `lines` to $NOTIFY_SOCKET, if it is set.

    hapticd sends READY=1, STATUS=..., WATCHDOG=1 and STOPPING=1.
    """
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    import socket  # a process without systemd does not load it

    if address.startswith("@"):
        address = f"\0{address[1:]}"  # a socket in the abstract namespace
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as service:
        service.sendto("\n".join(lines).encode(), address)


def feeding_period_ns() -> int:
    """Return a quarter of the interval of systemd's watchdog between two WATCHDOG=1; 0
    without one.
    """
    return int(os.environ.get("WATCHDOG_USEC", "0")) * NS_PER_US // 4


class Feeder:
    """Feed the watchdog of a process that calls `feed` often, and no more often than needed."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._period_ns = feeding_period_ns()
        self._fed_ns = 0

    def feed(self) -> None:
        """Send WATCHDOG=1 if due; nothing without a watchdog."""
        now_ns = self._clock.now_ns()
        if self._period_ns and now_ns - self._fed_ns >= self._period_ns:
            self._fed_ns = now_ns
            notify("WATCHDOG=1")
