"""How many cores a batch may use: those of the process, or fewer where whoever runs it shares
them out.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_granted: ContextVar[int | None] = ContextVar("granted", default=None)


def workers() -> int:
    """Cores that a batch which is begun here may use."""
    free = len(os.sched_getaffinity(0))
    return min(free, _granted.get() or free)


@contextmanager
def at_most(cores: int) -> Iterator[None]:
    """Batches begun inside, on this thread, use no more cores than these."""
    before = _granted.set(cores)
    try:
        yield
    finally:
        _granted.reset(before)
