"""Detection of a limit cycle: three signs that the display moves by itself, each a fault.

    force_at_limit  the force went REVERSALS times from one end of its limit to the other within
                    WINDOW_S: faster than 15 Hz. A hand taps at 7 Hz and trembles at 12; it may
                    press at the limit for any length of time
    overspeed       faster than the device file allows for FAST_S: longer than a glitch of the
                    encoder, which lasts for a sample or two, and faster than a handle thrown by
                    hand (see below)
    energy          more energy given out without cover than the device file allows
                    (`render.energy`); it needs a lower bound of the physical damping, and is off
                    without one

The tick detects the signs (`step` calls this only when the force is clamped or the speed is high)
and raises an alarm. The next tick takes the slow path, where the alarm becomes a fault while torque
is granted. Trials that go to the edge of stability on purpose switch `force_at_limit` and `energy`
off; every record shows which of them are on.

The default limit of overspeed is 0.7 of the speed beyond which the encoder is not trusted: 3.5 m/s
on the device of the paper. In half of its 40 mm of travel a hand that accelerates 20 times as fast
as gravity reaches 2.8 m/s; 8 g released 20 mm off under K = 200 N/m reach 3.2 m/s.

Limitations: a rate so low that FAST_S is less than a tick, a limit that changes while the force
lies at it.
"""

from math import ceil
from typing import Final, NamedTuple

from hapticd.core.faults import BY_CODE
from hapticd.core.params import ServoParams
from hapticd.mailbox.layout import Watched

REVERSALS: Final = 4
WINDOW_S: Final = 0.1
FAST_S: Final = 0.005
LEAK_S: Final = 1.0  # time constant of the excess energy

FORCE_AT_LIMIT = BY_CODE["force_at_limit"].number
OVERSPEED = BY_CODE["overspeed"].number
ENERGY = BY_CODE["energy"].number


class Signs(NamedTuple):
    """The state of the three signs."""

    alarm: int  # number of the fault that is due, 0: none
    side: int  # of the limit at which the force was last: 1, -1; 0: not yet
    reversals: tuple[int, ...]  # ticks at which it reached the other side
    fast_tick: int  # the last one that was too fast
    fast_ticks: int  # consecutive ones

    def raised(self, fault: int) -> "Signs":
        """Return it with an alarm, unless there is one already."""
        return self if self.alarm else self._replace(alarm=fault)


CALM = Signs(0, 0, (), 0, 0)


class Bounds(NamedTuple):
    """Bounds of the monitors, in ticks and SI units; inf: off."""

    window_ticks: int
    fast_ticks: int
    fast_m: float  # displacement in a tick
    resistance: float  # the device's own damping / period, N/m
    energy_j: float
    kept: float  # of the excess energy, in a tick


def bounds(params: ServoParams) -> Bounds:
    """Return the bounds for this device at this rate."""
    rate_hz = params.realtime.rate_hz
    device = params.device
    speed = device.overspeed_m_per_s
    damping = device.physical_damping_ns_per_m
    return Bounds(
        window_ticks=ceil(WINDOW_S * rate_hz),
        fast_ticks=ceil(FAST_S * rate_hz),
        fast_m=float("inf") if speed is None else speed / rate_hz,
        resistance=(damping or 0.0) * rate_hz,
        energy_j=float("inf") if damping is None else device.energy_limit_j,
        kept=1.0 - 1.0 / (LEAK_S * rate_hz),
    )


def watches(params: ServoParams, limit_cycle_faults: bool) -> int:
    """Return which of these faults are on, as bits of layout.Watched."""
    device = params.device
    on = {
        Watched.FORCE_AT_LIMIT: limit_cycle_faults,
        Watched.OVERSPEED: device.overspeed_m_per_s is not None,
        Watched.ENERGY: limit_cycle_faults and device.physical_damping_ns_per_m is not None,
    }
    return sum(bit for bit, yes in on.items() if yes)


def at_limit(signs: Signs, force_n: float, tick: int, window_ticks: int) -> Signs:
    """Return `signs` after a tick whose force was clamped to `force_n`."""
    side = 1 if force_n > 0.0 else -1
    if side == signs.side:
        return signs
    recent = [seen for seen in signs.reversals if tick - seen <= window_ticks]
    reversals = (*recent, tick) if signs.side else ()
    found = signs._replace(side=side, reversals=reversals)
    return found.raised(FORCE_AT_LIMIT) if len(reversals) >= REVERSALS else found


def too_fast(signs: Signs, tick: int, fast_ticks: int) -> Signs:
    """Return `signs` after a tick that was too fast."""
    count = signs.fast_ticks + 1 if signs.fast_tick == tick - 1 else 1
    found = signs._replace(fast_tick=tick, fast_ticks=count)
    return found.raised(OVERSPEED) if count >= fast_ticks else found
