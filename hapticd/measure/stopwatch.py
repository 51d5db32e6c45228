"""Seconds that a call takes, by a reading of nanoseconds that is passed in.

The command line passes the processor time of this process (`time.process_time_ns`): seconds of one core, whatever else the
machine does. What is timed here runs on one thread.
"""

from collections.abc import Callable
from typing import TypeVar

from hapticd.units import NS_PER_S

T = TypeVar("T")
Stopwatch = Callable[[], int]


def timed(now_ns: Stopwatch, call: Callable[[], T]) -> tuple[T, float]:
    """(what `call` returns, seconds that it took)."""
    begin_ns = now_ns()
    found = call()
    return found, (now_ns() - begin_ns) / NS_PER_S


def quickest(now_ns: Stopwatch, call: Callable[[], T], times: int = 3) -> tuple[T, float]:
    """The same for the quickest of `times` calls: what the work takes when nothing disturbs it."""
    found, least_s = timed(now_ns, call)
    for _ in range(times - 1):
        found, seconds = timed(now_ns, call)
        least_s = min(least_s, seconds)
    return found, least_s
