"""Ramps: a parameter on its way from one value to the next. Each carries its own start tick, so
several may overlap.
"""

from typing import NamedTuple

__all__ = ["Ramp", "approach", "constant"]


class Ramp(NamedTuple):
    """From `start` at `start_tick` to `end` at `start_tick + ticks`; `ticks` = 0 steps at once."""

    start: float
    end: float
    start_tick: int
    ticks: int

    def value(self, tick: int) -> float:
        """Value at `tick`: exactly `end` from the end tick on."""
        done = tick - self.start_tick
        if done >= self.ticks:
            return self.end
        if done <= 0:
            return self.start
        return self.start + (self.end - self.start) * (done / self.ticks)

    def running(self, tick: int) -> bool:
        """Whether a later tick gives another value."""
        return tick < self.start_tick + self.ticks and self.start != self.end

    def towards(self, end: float, tick: int, ticks: int) -> "Ramp":
        """Return a ramp that starts now from the present value."""
        return Ramp(self.value(tick), end, tick, ticks)


def constant(value: float) -> Ramp:
    """Return a finished ramp."""
    return Ramp(value, value, 0, 0)


def approach(value: float, target: float, step: float) -> float:
    """Return `value` moved towards `target` by at most `step` >= 0."""
    if target > value + step:
        return value + step
    if target < value - step:
        return value - step
    return target
