"""Operating-system rights of the servo process: the requests and their results.

Each right is requested on its own and the result is kept. SCHED_FIFO decides the 99th percentile
(45 us against 8.5 ms on a busy machine). Locked memory and a frozen, disabled garbage collector
keep page faults and collections out of the tick. Timer slack and the C-state latency shape the
wake-up. In strict mode a refusal stops the start; otherwise it is reported with its remedy and the
loop runs without that right. FIFO comes last, so that nothing slow runs under it.

Limitations: a second thread (one lock of the interpreter), a scheduler that throttles (duty stays
below 90 %).
"""

import ctypes
import gc
import os
import resource
from collections.abc import Callable
from typing import NamedTuple

from hapticd.core.errors import RealtimeError
from hapticd.core.params import RealtimeParams

__all__ = ["prepare", "relax"]

_PR_SET_TIMERSLACK = 29
_MCL_CURRENT_AND_FUTURE = 3
_libc = ctypes.CDLL(None, use_errno=True)
_held: list[int] = []  # the kernel forgets the C-state latency when its file is closed


class Grant(NamedTuple):
    """The result of a request for a right; `text`: why it was refused, and the remedy."""

    granted: bool
    text: str


def prepare(params: RealtimeParams) -> dict[str, Grant]:
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


def relax() -> None:
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
