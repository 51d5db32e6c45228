"""Covariances of a long record from short transforms (Rader 1970, "An improved algorithm for high
speed autocorrelation").

The record is cut into sections of M samples, each padded with zeros to 2 M and transformed once.
Lags 0..M of section i with the record that follows it need section i and i + 1 only, and shifting
section i + 1 by M samples is a factor (-1)^k on bin k. Summing conj(U_i) (Y_i + (-1)^k Y_{i+1})
over all sections and one inverse transform at the end give the exact biased covariances: memory
O(M), any length, fed in pieces of any size. About 43 Mflop for 360,000 samples, against 1.5 Gflop
direct.

What would break it: a lag that changes while sums are kept, or blocks of unequal length in the two
channels (refused).
"""

from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.kernels import kernels
from hapticd.errors import AnalysisError

TOGETHER = 32_768  # samples transformed together: their spectra stay in the second-level cache


@dataclass(frozen=True)
class Covariances:
    """Biased covariances (1/N) for lags t = 0..M, each (M + 1,) float64.

    `velocity` R_u [(m/s)^2], `force` R_y [N^2], `forward` R_yu(t) = 1/N sum y(k+t) u(k) and
    `backward` R_yu(-t) [N m/s].
    """

    velocity: Floats
    force: Floats
    forward: Floats
    backward: Floats
    n_samples: int


class Sections:
    """Sums over a record that arrives in blocks. `covariances()` may be asked at any time and
    changes nothing.
    """

    def __init__(self, lag: int) -> None:
        self.lag = lag
        self.n_samples = 0
        self._together = max(1, TOGETHER // lag)
        self._sums = np.zeros((4, lag + 1), np.complex128)
        self._waiting = np.zeros((2, 0))  # less than a section of velocity and force
        self._padded = np.zeros((self._together, 2 * lag))
        self._spectra = np.zeros(
            (2, self._together + 1, lag + 1), np.complex128
        )  # row 0: of the section before, zero at first

    def add(self, force: Floats, velocity: Floats) -> None:
        """Append samples, both (n,) float64. AnalysisError for unequal lengths."""
        same_length(force, velocity)
        self.n_samples += force.size
        start = self._fill_up(force, velocity)
        whole = (force.size - start) // self.lag
        stop = start + whole * self.lag
        rows = [signal[start:stop].reshape(whole, self.lag) for signal in (velocity, force)]
        for first in range(0, whole, self._together):
            self._take([channel[first : first + self._together] for channel in rows])
        self._waiting = np.concatenate((self._waiting, (velocity[stop:], force[stop:])), axis=1)

    def covariances(self) -> Covariances:
        """Of all samples so far, as they are: no trend is taken out. Without samples an
        AnalysisError.
        """
        if not self.n_samples:
            raise AnalysisError("no samples: nothing to correlate; feed a record first")
        end = np.zeros((2, 2, 2 * self.lag))
        end[:, 0, : self._waiting.shape[1]] = self._waiting
        u, y = np.concatenate((self._spectra[:, :1], np.fft.rfft(end, axis=2)), axis=1)
        sums = self._sums.copy()
        kernels().accumulate(u, y, sums)
        lags = np.fft.irfft(sums, axis=1)[:, : self.lag + 1] / self.n_samples
        return Covariances(lags[0], lags[1], lags[2], lags[3], self.n_samples)

    def _fill_up(self, force: Floats, velocity: Floats) -> int:
        """Complete the section that waits; how many samples of the block that took."""
        held = self._waiting.shape[1]
        missing = self.lag - held if held else 0
        if force.size < missing:
            return 0  # all of it waits
        if held:
            section = np.concatenate((self._waiting, (velocity[:missing], force[:missing])), axis=1)
            self._take([section[:1], section[1:]])
            self._waiting = np.zeros((2, 0))
        return missing

    def _take(self, rows: list[Floats]) -> None:
        """Sections (n, M) of velocity and force into the sums, n up to `_together`."""
        count = len(rows[0])
        padded = self._padded[:count]
        for channel, sections in enumerate(rows):
            padded[:, : self.lag] = sections
            np.fft.rfft(padded, axis=1, out=self._spectra[channel, 1 : count + 1])
        kernels().accumulate(
            self._spectra[0, : count + 1], self._spectra[1, : count + 1], self._sums
        )
        self._spectra[:, 0] = self._spectra[:, count]


def same_length(force: Floats, velocity: Floats) -> None:
    """AnalysisError unless both are (n,)."""
    if force.ndim != 1 or force.shape != velocity.shape:
        raise AnalysisError(
            f"force {force.shape} and velocity {velocity.shape}: two records of one length are"
            " needed"
        )
