"""Common behaviour of every hapticd process: its start and its end.

A process ends with its parent, and on SIGINT and SIGTERM alike.

Signals must be handled in the main thread: Python runs handlers there.
"""

import ctypes
import os
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import subprocess

__all__ = ["die_with_parent", "launch", "on_stop"]

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
