"""Streaming a waveform into the board's perturbation FIFO.

The board plays one sample per 250 us of its own clock, which is not the host's. The host therefore looks at the level in
each IN frame and sends one sample more or fewer than the nominal number (at 1 kHz 3, 4 or 5), to hold the FIFO near 8 of
16: neither end runs dry or over while the clocks differ by less than 25 %.
"""

import math

from hapticd.units import PROBE_RATE_HZ
from hapticd.wire.frames import FIFO_TARGET, PROBE_MAX

Burst = tuple[int, tuple[int, ...]]  # samples that count, always PROBE_MAX values
NOTHING: Burst = (0, (0,) * PROBE_MAX)


class Streamer:
    """Plays `samples` counts of `waveform` (memoryview of i16), once or for ever."""

    def __init__(self, waveform: "memoryview[int]", rate_hz: float) -> None:
        nominal = PROBE_RATE_HZ / rate_hz
        self._waveform = waveform
        self._least, self._most = max(0, math.floor(nominal) - 1), min(PROBE_MAX, math.ceil(nominal) + 1)
        self._position = self._samples = 0
        self._loop = self._first = False

    def start(self, samples: int, loop: bool) -> None:
        """Begin at the first sample."""
        self._position, self._samples, self._loop, self._first = 0, min(samples, len(self._waveform)), loop, True

    @property
    def exhausted(self) -> bool:
        """Whether everything has been sent."""
        return self._position >= self._samples and not self._loop

    def burst(self, level: int) -> Burst:
        """What to send to a FIFO at `level`; the first burst is as large as a frame allows."""
        wanted = PROBE_MAX if self._first else min(self._most, max(self._least, FIFO_TARGET - level))
        self._first = False
        if self._loop and self._position >= self._samples:
            self._position = 0
        taken = self._waveform[self._position : min(self._position + wanted, self._samples)].tolist()
        self._position += len(taken)
        return (len(taken), (*taken, *NOTHING[1][len(taken) :])) if taken else NOTHING
