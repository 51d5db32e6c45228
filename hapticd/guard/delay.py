"""Estimate the loop delay of the last minute, for the judgements of the guard.

Each record contains `delay_us`, the delay from a sample to its force, for the force in effect when
the record's own sample was taken. This module counts these delays by second, in steps of 1/16
period. The guard uses the 99th percentile, rounded up to the next step. A longer delay counts at
once; a shorter one counts after 10 s, because each new delay costs the worker 0.5 s. The theorem
assumes a constant delay, and every verdict includes this limitation.

The delay must be rounded up, and a minute without records must not count the one before.
"""

import numpy as np
from numpy.typing import NDArray

from hapticd.core.units import NS_PER_S, US_PER_S
from hapticd.protocol.view import Records

STEPS = 16  # of a period
MOST_PERIODS = 16
BINS = STEPS * MOST_PERIODS + 1  # the last bin includes all longer delays
KEPT_S = 60
SHARE = 0.99
LEAST_RECORDS = 500  # before the first percentile
SHORTER_S = 10


class DelayHistogram:
    """Histogram of the delays of the last KEPT_S seconds, at a servo rate [Hz]."""

    def __init__(self, rate_hz: float) -> None:
        self._steps_per_us = STEPS * rate_hz / US_PER_S
        self.clear()

    def clear(self) -> None:
        """Start again, for another servo life."""
        self._counts = np.zeros((KEPT_S, BINS), np.int64)  # by second, modulo KEPT_S
        self._total = np.zeros(BINS, np.int64)  # over all seconds
        self._newest = -KEPT_S  # s
        self.periods: float | None = None  # a multiple of 1/16; None: not yet known
        self._shorter_since: int | None = None  # s

    def add(self, records: Records) -> None:
        """Count the records whose delay is known."""
        delay_us = records["delay_us"]
        known = delay_us >= 0
        seconds = records["time_ns"][known] // NS_PER_S
        if not seconds.size:
            return
        # tolerate floating-point rounding at a step
        steps = np.ceil(delay_us[known] * self._steps_per_us - 1e-6).astype(np.int64)
        for second in sorted(set(seconds.tolist())):
            self._count(second, np.minimum(steps[seconds == second], BINS - 1))
        self._follow()

    def _count(self, second: int, steps: NDArray[np.int64]) -> None:
        if second <= self._newest - KEPT_S:
            return  # too old: a clock was set back
        for begun in range(max(self._newest, second - KEPT_S) + 1, second + 1):
            self._total -= self._counts[begun % KEPT_S]
            self._counts[begun % KEPT_S] = 0
        counts = np.bincount(steps, minlength=BINS)
        self._counts[second % KEPT_S] += counts
        self._total += counts
        self._newest = max(self._newest, second)

    def _follow(self) -> None:
        """Update the delay that 99 % of the ticks did not exceed, in periods; shorter
        ones later.
        """
        below = np.cumsum(self._total)
        if below[-1] < LEAST_RECORDS:
            return
        measured = float(np.searchsorted(below, SHARE * below[-1]) / STEPS)
        if self.periods is None or measured >= self.periods:
            self.periods = measured
            self._shorter_since = None
            return
        since = self._newest if self._shorter_since is None else self._shorter_since
        self._shorter_since = since
        if self._newest - since >= SHORTER_S:
            self.periods = measured
            self._shorter_since = None
