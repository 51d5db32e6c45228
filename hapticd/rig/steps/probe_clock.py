"""How the probe's samples stand in the board's time.

The encoder is latched at times that the board tells. The intervals of the probe end at multiples of
250 us of the same clock, to within a constant. The encoder's way and the integral of the velocity
agree for the right constant alone, to some 0.1 us. The same equation gives the gain between both,
the corner of a high-pass in the velocity channel, and by how much the encoder goes further at high
frequencies (a transmission that yields).

What would break it: a handle that hardly moves within CLOCK_HZ, so that nothing tells the constant.
"""

from dataclasses import dataclass

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.core.units import PROBE_RATE_HZ, US_PER_S
from hapticd.rig.jackknife import lines, solved
from hapticd.rig.played import SAMPLE_US, Played

H_S = 1.0 / PROBE_RATE_HZ
CLOCK_HZ = (5.0, 40.0)
CLOCK_BLOCK_S = 1.0
CLOCK_ROUNDS = 5


@dataclass(frozen=True, slots=True)
class Clock:
    """How the probe's samples stand in the board's time."""

    phase_us: float  # board's time at which the interval of index 0 began
    gain: float  # encoder's way by the integral of the velocity
    high_pass_rad_s: float  # corner of the velocity channel
    yield_s2: float  # by which the encoder goes further, by the square of the frequency [rad/s]


def clocked(run: Played) -> Clock:
    """Where the probe's intervals lie in the board's time."""
    late_us = run.board_us - SAMPLE_US * (run.last_index + 1.0)
    # an interval that had come was over, the next one was not
    phase_us = 0.5 * (float(late_us.max()) - SAMPLE_US + float(late_us.min()))
    corner = 0.0
    for _ in range(CLOCK_ROUNDS):
        found = _phase(run, phase_us, corner)
        phase_us = found.phase_us
        corner = found.high_pass_rad_s
    return found


def passed(values: Floats, corner_rad_s: float) -> Floats:
    """`values` (n,) without their mean, as they were before a high-pass of that corner."""
    own = values - values.mean()
    return np.asarray(own + corner_rad_s * (np.cumsum(own) - 0.5 * own) * H_S)


def _phase(run: Played, phase_us: float, corner_rad_s: float) -> Clock:
    """The clock again, from a guess of its phase and of the channel's high-pass."""
    v = passed(run.velocity_m_per_s, corner_rad_s)
    at = (run.board_us - phase_us) / SAMPLE_US - run.first_index
    inside = (at >= 1.0) & (at < v.size - 2.0)
    seen = _way_m(v, at[inside])
    speed = np.interp(at[inside] - 0.5, np.arange(v.size), v)
    rate_hz = US_PER_S / run.period_us
    lost = np.cumsum(seen - seen.mean()) / rate_hz
    bent = np.zeros(seen.size)
    bent[1:-1] = -np.diff(seen, 2) * rate_hz**2
    columns = (seen, speed, lost, bent, run.position_m[inside])
    parts = [_ticks(one[1:-1], rate_hz) for one in columns]
    fit = solved(np.dstack(parts[:-1]), parts[-1])
    gain, shift, corner, further = fit.values.tolist()
    return Clock(
        phase_us - US_PER_S * shift / gain,
        gain,
        corner_rad_s + corner / gain,
        further / gain,
    )


def _way_m(v: Floats, at: Floats) -> Floats:
    """The integral (k,) of the interval means `v` (n,) at the times `at` (k,) in intervals, by the
    parabola that each interval has with its neighbours.
    """
    way_m = np.concatenate(([0.0], np.cumsum(v))) * H_S
    whole = np.floor(at).astype(np.int64)
    part = at - whole
    bend = 0.25 * part * (1.0 - part) * (v[whole + 1] - v[whole - 1]) * H_S
    return np.asarray(way_m[whole] + part * v[whole] * H_S - bend)


def _ticks(values: Floats, rate_hz: float) -> Floats:
    return lines(values, round(CLOCK_BLOCK_S * rate_hz), rate_hz, CLOCK_HZ)
