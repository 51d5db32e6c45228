"""The board's 4 kHz half: perturbation FIFO in, interval-mean pairs out.

Every 250 us of board time one interval ends. It yields a pair: the mean perturbation torque that
was output in it and the mean velocity, which is the distance travelled over 250 us, so that the sum
of torque x velocity x 250 us is the exact work. The next interval then plays the next sample of the
FIFO, or 0 when it is dry (an under-run). Pairs wait, 64 at most, until the host has read them;
beyond, the oldest is lost and the gap shows in the index.

What would break it: an interval grid that is not the plant's sub-step grid. Where 250 us are no
whole number of sub-steps (rates that are not multiples of 250 Hz) an interval ends at the nearest
sub-step: 4 kHz on average.
"""

from collections import deque
from collections.abc import Sequence
from math import floor
from random import Random

from hapticd.params import BoardParams
from hapticd.plant.step import SUBSTEPS_PER_TICK
from hapticd.units import PROBE_RATE_HZ
from hapticd.wire.codec import I16_HIGHEST, I16_LOWEST
from hapticd.wire.frames import FIFO_DEPTH, Status

PAIRS_MAX = 64
UNDERRUN = Status.FIFO_UNDERRUN.value
OVERFLOW = Status.FIFO_OVERFLOW.value
PAIRS_LOST = Status.PROBE_OVERFLOW.value


def i16_count(value: float) -> int:
    """Nearest count, halves upwards, held at the ends of 16 bits as a converter does."""
    count = floor(value + 0.5)
    if I16_LOWEST <= count <= I16_HIGHEST:
        return count
    return I16_HIGHEST if count > 0 else I16_LOWEST


class Probe:
    """Perturbation and measurement of one axis. `end` is the sub-step at which the running
    interval ends.
    """

    __slots__ = (
        "_counts",
        "_gauss",
        "_length",
        "_n_per_count",
        "_noise",
        "_sample",
        "_start",
        "_start_m",
        "_start_ns",
        "_torque_scale",
        "_velocity_scale",
        "end",
        "events",
        "fifo",
        "first_index",
        "index",
        "live",
        "pairs",
        "playing",
        "torque_n",
    )

    def __init__(self, params: BoardParams) -> None:
        substep_rate_hz = SUBSTEPS_PER_TICK * params.rate_hz
        self._length = substep_rate_hz / PROBE_RATE_HZ  # sub-steps in an interval
        self._n_per_count = params.probe_torque_n_per_count
        self._velocity_scale = substep_rate_hz / params.probe_velocity_m_per_s_per_count
        self._torque_scale = substep_rate_hz / params.probe_torque_n_per_count
        noise = params.plant and params.plant.noise
        self._noise = (
            noise.velocity_m_per_s / params.probe_velocity_m_per_s_per_count if noise else 0.0
        )
        self._gauss = Random(params.seed).gauss
        self.power_up(0.0)

    def power_up(self, position_m: float) -> None:
        """Forget everything; interval 0 starts at sub-step 0."""
        self.fifo: deque[int] = deque()
        self.pairs: list[int] = []  # torque, velocity, torque, velocity: oldest first
        self.index = 0  # intervals ended since power-up
        self.first_index = 0  # index of the oldest pair
        self.events = 0  # Status bits since they were last taken
        self.playing = self.live = False
        self.torque_n = 0.0
        self._sample = self._counts = 0  # count being output; mean count of the running interval
        self._start = 0
        self._start_m = position_m
        self._start_ns = 0.0
        self.end = floor(self._length + 0.5)

    def queue(self, samples: Sequence[int]) -> None:
        """Append perturbation samples; those that do not fit are dropped and flagged."""
        room = FIFO_DEPTH - len(self.fifo)
        if len(samples) > room:
            self.events |= OVERFLOW
            samples = samples[:room]
        self.fifo.extend(samples)

    def silence(self, substep: int) -> None:
        """No torque from `substep` on, in the middle of an interval: its mean keeps what was
        output before.
        """
        if self._sample:
            done = (substep - self._start) / (self.end - self._start)
            self._counts = i16_count(self._sample * done)
            self._sample = 0
            self.torque_n = 0.0

    def end_interval(self, travel_m: float, impulse_ns: float | None = None) -> None:
        """The interval that ends at `end` is over: integral of the recorded velocity, and what
        filters keep of the torque's.
        """
        end = self.end
        pairs = self.pairs
        length = end - self._start
        if impulse_ns is None:
            pairs.append(self._counts)
        else:
            pairs.append(
                i16_count(
                    self._counts + (impulse_ns - self._start_ns) * self._torque_scale / length
                )
            )
            self._start_ns = impulse_ns
        counts = (travel_m - self._start_m) * self._velocity_scale / length
        pairs.append(
            i16_count(counts + self._noise * self._gauss(0.0, 1.0) if self._noise else counts)
        )
        self.index = index = self.index + 1
        if len(pairs) > 2 * PAIRS_MAX:
            del pairs[:2]
            self.first_index += 1
            self.events |= PAIRS_LOST
        self._start = end
        self._start_m = travel_m
        self.end = floor((index + 1) * self._length + 0.5)
        sample = self._next_sample() if self.playing else 0
        if sample != self._sample or self._counts != sample:
            self._sample = self._counts = sample
            self.torque_n = sample * self._n_per_count

    def _next_sample(self) -> int:
        if not self.fifo:
            self.events |= UNDERRUN
            return 0
        sample = self.fifo.popleft()
        return sample if self.live else 0

    def forget(self, index: int) -> None:
        """The host has the pairs before `index`."""
        known = index - self.first_index
        if known > 0:
            del self.pairs[: 2 * known]
            self.first_index = index
