"""Clocks, passed to all code that waits or takes time stamps.

`MonotonicClock` is the machine's CLOCK_MONOTONIC. `VirtualClock` advances only when it is moved, so
the whole stack runs in lock-step, faster than real time and without sleeping. Readings are integer
nanoseconds since an arbitrary origin.
"""

import time
from abc import ABC, abstractmethod

from hapticd.core.units import NS_PER_S

__all__ = ["Clock", "MonotonicClock", "VirtualClock"]


class Clock(ABC):
    """The interface of every clock."""

    @abstractmethod
    def now_ns(self) -> int:
        """Return nanoseconds since an arbitrary origin; never decreasing."""

    @abstractmethod
    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Return at or after `deadline_ns`; at once if it has passed."""


class MonotonicClock(Clock):
    """The machine's clock."""

    now_ns = staticmethod(time.monotonic_ns)  # without a Python call: the tick reads it four times

    def sleep_until_ns(self, deadline_ns: int) -> None:
        wait_ns = deadline_ns - time.monotonic_ns()
        if wait_ns > 0:
            time.sleep(wait_ns / NS_PER_S)


class VirtualClock(Clock):
    """A clock that tests and lock-step runs advance."""

    def __init__(self, start_ns: int = 0) -> None:
        self.time_ns = start_ns

    def now_ns(self) -> int:
        return self.time_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        if deadline_ns > self.time_ns:
            self.time_ns = deadline_ns
