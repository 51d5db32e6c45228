"""A processor on which a tick takes time, on virtual time: a model of a slow machine.

The loop reads its clock once after each stage, so the cost of a stage passes at that reading. A
stage takes nine tenths of its cost and an exponential rest.
"""

from collections.abc import Callable
from random import Random
from typing import Any

from hapticd.core.units import Clock, VirtualClock
from hapticd.mailbox.layout import STAGES
from hapticd.run.lockstep import LockStep

# of an enabled tick without a bus, CPython 3.11 without profile-guided optimisation, Zen 3 [ns]
COSTS_NS = {"read": 3000, "step": 9000, "write": 2000, "publish": 4000}
TICK_US = sum(COSTS_NS.values()) / 1000.0
FIXED = 0.9  # constant share of a cost


class Processor(Clock):
    """The clock of the loop of `stack`; `slowness` times slower than that machine."""

    def __init__(self, stack: LockStep, slowness: float, seed: int = 1) -> None:
        self._clock: VirtualClock = stack.clock
        self._random = Random(seed)
        self._costs_ns = [slowness * COSTS_NS[stage] for stage in STAGES[1:]]
        self._left_ns: list[float] = []  # of this tick
        loop: Any = stack.loop
        loop.clock = self
        loop.wait = self._waking(loop.wait)

    def now_ns(self) -> int:
        if self._left_ns:
            varies = (1.0 - FIXED) * self._random.expovariate(1.0)
            self._clock.time_ns += round((FIXED + varies) * self._left_ns.pop(0))
        return self._clock.now_ns()

    def sleep_until_ns(self, deadline_ns: int) -> None:
        self._clock.sleep_until_ns(deadline_ns)

    def _waking(self, wait: Callable[..., int]) -> Callable[..., int]:
        def woken(*given: Any) -> int:
            start_ns = wait(*given)
            self._left_ns = list(self._costs_ns)
            return start_ns

        return woken
