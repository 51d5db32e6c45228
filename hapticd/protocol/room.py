"""How much of its period a tick leaves, by the stages that were measured since the servo started.

A tick that takes nearly all of its period is late whenever anything holds it up. Below a quarter
left the daemon warns, once for each life of the servo, and names the highest rate that leaves it.
A tick takes the sum of the medians of its stages but the wake-up, transfers included.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hapticd.core.units import US_PER_S
from hapticd.mailbox.layout import STAGES

__all__ = ["ENOUGH", "Room", "room_of"]

LEFT = 0.25  # of a period, at least
ENOUGH = 1000  # ticks before it is judged
WORK = STAGES[1:]
RATE_STEP_HZ = 10.0


@dataclass(frozen=True, slots=True)
class Room:
    """What a tick takes of its period."""

    tick_us: float = 0.0  #: 0: not known yet
    period_us: float = 0.0
    highest_rate_hz: float = 0.0  #: at which a quarter of the period is left; 0: not known yet

    @property
    def short(self) -> bool:
        """Whether less than a quarter of the period is left."""
        return self.tick_us > (1.0 - LEFT) * self.period_us

    @property
    def text(self) -> str:
        """The warning."""
        share = 100.0 * self.tick_us / self.period_us
        return (
            f"a tick takes {self.tick_us:.0f} us of its {self.period_us:.0f} us ({share:.0f} %, at"
            f" most {100.0 * (1.0 - LEFT):.0f} % is safe): ticks will be late; set"
            f" realtime.rate_hz to {self.highest_rate_hz:g} or less, or see `hapticd doctor`"
        )


def room_of(stages: Mapping[str, Mapping[str, Any]], rate_hz: float) -> Room:
    """The room at `rate_hz` by the percentiles of `stages` (`gateway.tick_times`)."""
    period_us = US_PER_S / rate_hz
    if stages[WORK[0]]["count"] < ENOUGH:
        return Room(0.0, period_us, 0.0)
    tick_us = sum(stages[stage]["p50_us"] for stage in WORK)
    highest_hz = (1.0 - LEFT) * US_PER_S / max(tick_us, 1.0)
    return Room(tick_us, period_us, highest_hz // RATE_STEP_HZ * RATE_STEP_HZ)
