"""The start and the end of a hapticd process, and the real-time rights of the servo.

A process ends with its parent, and on SIGINT and SIGTERM alike.

Rights (`request_rights`). Each right of the operating system is requested on its own and the result
is kept. SCHED_FIFO decides the 99th percentile (45 us against 8.5 ms on a busy machine). Locked
memory and a frozen, disabled garbage collector keep page faults and collections out of the tick.
Timer slack and the C-state latency shape the wake-up. In strict mode a refusal stops the start;
otherwise it is reported with its remedy and the loop runs without that right. FIFO comes last, so
that nothing slow runs under it.

Signals must be handled in the main thread: Python runs handlers there.

Limitations: a second thread (one lock of the interpreter), a scheduler that throttles (duty stays
below 90 %).
"""

import ctypes
import gc
import os
import resource
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from hapticd.core.errors import RealtimeError

if TYPE_CHECKING:
    import subprocess

    from hapticd.core.params import RealtimeParams

__all__ = ["die_with_parent", "launch", "on_stop", "ordinary_scheduling", "request_rights"]

_PR_SET_PDEATHSIG = 1  # of <linux/prctl.h>
_libc = ctypes.CDLL(None, use_errno=True)


def die_with_parent(parent_pid: int | None) -> None:
    """Let the kernel send SIGTERM when the parent ends; end at once if it has already ended.

    None: a process without a parent to follow.
    """
    if parent_pid is None:
        return
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
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


# --- real-time rights -----------------------------------------------------------------------------

_PR_SET_TIMERSLACK = 29
_MCL_CURRENT_AND_FUTURE = 3
_held: list[int] = []  # the kernel forgets the C-state latency when its file is closed


class Grant(NamedTuple):
    """The result of a request for a right; `text`: why it was refused, and the remedy."""

    granted: bool
    text: str


def request_rights(params: "RealtimeParams") -> dict[str, Grant]:
    """Request all rights in `params`; return the results by right, none in mode off.

    RealtimeError in strict mode if any was refused.
    """
    if params.mode == "off":
        return {}
    core = params.core if params.core is not None else max(os.sched_getaffinity(0))
    wanted: list[tuple[str, Callable[[], None], str]] = [
        (
            "core",
            lambda: os.sched_setaffinity(0, {core}),
            f"allow core {core} to this process (cpuset)",
        ),
        ("timer_slack", _timer_slack, "none known"),
        ("c_states", _c_states, "write access to /dev/cpu_dma_latency for the service group"),
        ("garbage_collector", _collect_and_stop, "none known"),
    ]
    if params.lock_memory:
        wanted.append(("memory", _lock_memory, "LimitMEMLOCK=infinity or `ulimit -l unlimited`"))
    wanted.append(
        ("fifo", lambda: _fifo(params.priority), f"LimitRTPRIO={params.priority} or CAP_SYS_NICE")
    )
    report = {name: _ask(action, remedy) for name, action, remedy in wanted}
    refused = [f"{name}: {one.text}" for name, one in report.items() if not one.granted]
    if params.mode == "strict" and refused:
        raise RealtimeError("; ".join(refused))
    return report


def ordinary_scheduling() -> None:
    """Return to ordinary scheduling, for an orderly end."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _ask(action: Callable[[], None], remedy: str) -> Grant:
    try:
        action()
    except (OSError, ValueError) as error:
        return Grant(False, f"refused: {error}; {remedy}")
    return Grant(True, "granted")


def _checked(result: int, what: str) -> None:
    if result:
        raise OSError(ctypes.get_errno(), f"{what}: {os.strerror(ctypes.get_errno())}")


def _timer_slack() -> None:
    _checked(_libc.prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(1), 0, 0, 0), "prctl")


def _c_states() -> None:
    descriptor = os.open("/dev/cpu_dma_latency", os.O_WRONLY | os.O_CLOEXEC)
    os.write(descriptor, bytes(4))
    _held.append(descriptor)


def _collect_and_stop() -> None:
    gc.collect()
    gc.freeze()
    gc.disable()


def _lock_memory() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if soft != hard:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (hard, hard))
    _checked(_libc.mlockall(_MCL_CURRENT_AND_FUTURE), "mlockall")


def _fifo(priority: int) -> None:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
