"""The wait of the loop for its next deadline.

Live: sleep to `spin` before the deadline, then spin on the clock. The kernel wakes a sleeper 10-60
us late. The spin makes the tick start within 0.1 us for 10 % of a core at 1 kHz and warms the
caches. Deadlines lie half a period off the millisecond, away from the scheduler's own tick. In a
millisecond of sleep the caches go cold, and a tick costs twice as much as a hot one. A rehearsal of
the tick on dummy data at the start of the spin warms them. In virtual time: move the clock.

A rehearsal must have no effect.
"""

import time
from collections.abc import Callable

from hapticd.core.clock import Clock
from hapticd.core.units import NS_PER_MS, NS_PER_S

__all__ = ["Wait", "first_deadline", "spinning_wait", "virtual_wait"]

Wait = Callable[[int, Callable[[], object]], int]
REHEARSAL_NS = 30_000  # room that a rehearsal needs before the deadline


def spinning_wait(spin_ns: int, period_ns: int) -> Wait:
    """Return `wait(deadline_ns, rehearse)` -> monotonic ns at or after the deadline. The spin takes
    at most 0.4 periods: the core needs idle time.
    """
    margin_ns = min(spin_ns, int(0.4 * period_ns))
    clock = time.monotonic_ns
    sleep = time.sleep
    per_ns = 1.0 / NS_PER_S

    def wait(deadline_ns: int, rehearse: Callable[[], object]) -> int:
        ahead = deadline_ns - margin_ns - clock()
        if ahead > 0:
            sleep(ahead * per_ns)
        if deadline_ns - clock() > REHEARSAL_NS:
            rehearse()
        now = clock()
        while now < deadline_ns:
            now = clock()
        return now

    return wait


def virtual_wait(clock: Clock) -> Wait:
    """Return `wait` on a clock that jumps."""

    def wait(deadline_ns: int, _rehearse: Callable[[], object]) -> int:
        clock.sleep_until_ns(deadline_ns)
        return clock.now_ns()

    return wait


def first_deadline(now_ns: int, period_ns: int) -> int:
    """Return a deadline a few periods ahead, half a period off the millisecond."""
    return (now_ns // NS_PER_MS + 3) * NS_PER_MS + period_ns // 2
