"""Streaming a waveform into the board's perturbation FIFO.

The board plays one sample per 250 us of its own clock, which is not the host's. The host therefore
looks at the level in each IN frame and sends one sample more or fewer than the nominal number (at 1
kHz 3, 4 or 5), to hold the FIFO near 8 of 16: neither end runs dry or over while the clocks differ
by less than 25 %. A waveform that is played once ends when the FIFO has run dry after its last
sample; the under-run that the board then reports is the end, not a loss.
"""

import math

from hapticd.units import PROBE_RATE_HZ
from hapticd.wire.codec import NO_SAMPLES
from hapticd.wire.frames import FIFO_TARGET, PROBE_MAX, OutFlag

Burst = tuple[int, int, tuple[int, ...]]  # OUT flags, samples that count, always PROBE_MAX values
_FIFO_CLEAR = int(OutFlag.FIFO_CLEAR)


class Streamer:
    """Plays counts of `waveform` (memoryview of i16) as the plan's `wave` says: (command number
    or 0, samples, loop).
    """

    def __init__(self, waveform: "memoryview[int]", rate_hz: float) -> None:
        nominal = PROBE_RATE_HZ / rate_hz
        self._waveform = waveform
        self._least, self._most = (
            max(0, math.floor(nominal) - 1),
            min(PROBE_MAX, math.ceil(nominal) + 1),
        )
        self._position = self._samples = 0
        self._loop = False
        self.playing = 0  # number of the command that started it, 0: silent

    def follow(self, wave: tuple[int, int, bool], flags: int, level: int) -> Burst:
        """What to send to a FIFO at `level`; `flags` gain FIFO_CLEAR on the tick a waveform
        begins or ends.
        """
        number, samples, loop = wave
        begins = number != self.playing
        if begins:
            self.playing, self._position, self._samples, self._loop = (
                number,
                0,
                min(samples, len(self._waveform)),
                loop,
            )
            flags |= _FIFO_CLEAR
        if not number:
            return flags, 0, NO_SAMPLES
        wanted = PROBE_MAX if begins else min(self._most, max(self._least, FIFO_TARGET - level))
        return (flags, *self._next(wanted))

    def ended(self, level: int) -> bool:
        """Whether a waveform that plays once has been played to its end."""
        return (
            self.playing != 0 and not self._loop and self._position >= self._samples and level == 0
        )

    def _next(self, wanted: int) -> tuple[int, tuple[int, ...]]:
        if self._loop and self._position >= self._samples:
            self._position = 0
        taken = self._waveform[
            self._position : min(self._position + wanted, self._samples)
        ].tolist()
        self._position += len(taken)
        return len(taken), (*taken, *NO_SAMPLES[len(taken) :])
