"""What every hapticd process does about its end: it dies with its parent and stops on SIGINT
and SIGTERM alike.
"""

import ctypes
import os
import signal
from collections.abc import Callable

_PR_SET_PDEATHSIG = 1


def die_with_parent(parent_pid: int | None) -> None:
    """Have the kernel send SIGTERM when the parent ends; end at once if it is gone already.
    None: stand alone.
    """
    if parent_pid is None:
        return
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent_pid:
        os.kill(os.getpid(), signal.SIGTERM)


def on_stop(handler: Callable[[], None]) -> None:
    """Call `handler` on SIGINT and SIGTERM, also where a shell's background job had SIGINT
    ignored.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda _signal, _frame: handler())
