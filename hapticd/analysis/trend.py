"""Linear trends, removed from a record or from its covariances.

The paper (Weir, Colgate and Peshkin 2008, section 2.2) detrends the whole record before `spa`. With
t = k - (N - 1)/2 the least-squares line is mean + slope t, slope = sum(t x) / (N (N^2 - 1) / 12):
two passes, no equations to solve.

A stream cannot go back to its beginning. It sums raw products and takes the lines out of the
covariances afterwards: the products of a signal with a line need only the totals sum(x) and sum(k
x) and the first and last M samples. What would break that: an offset some 10^6 times the motion,
which leaves nothing of sixteen digits.
"""

from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.kernels import kernels


def detrended(signal: Floats) -> Floats:
    """`signal` (N,) float64 without its least-squares line, in a new array. MATLAB's
    `detrend(x, 1)`.
    """
    out = np.empty(signal.size)
    kernels().take_line_out(signal, *kernels().fitted_line(signal), out)
    return out


@dataclass(frozen=True)
class Moments:
    """What is kept of a signal to take its line out later: length, sum(x), sum(k x), first and last
    samples.

    Of one signal, or of many of one length: then `total` and `moment` (n,), `head` and `tail` (n,
    samples).
    """

    length: int
    total: Floats
    moment: Floats
    head: Floats
    tail: Floats

    def extended(self, block: Floats, keep: int) -> "Moments":
        """With `block` appended; `keep` samples are remembered at each end."""
        k = np.arange(self.length, self.length + block.size, dtype=np.float64)
        missing = max(0, keep - self.head.size)
        return Moments(
            self.length + block.size,
            self.total + block.sum(),
            self.moment
            + (k * block).sum(),  # a BLAS product has other last bits on another number of cores
            np.concatenate((self.head, block[:missing])),
            np.concatenate((self.tail, block))[-keep:],
        )

    def line(self) -> tuple[Floats, Floats]:
        """Value at k = 0 and slope per sample of the least-squares line, (1,) or (n, 1)."""
        n = self.length
        mean = self.total[..., None] / n
        slope = (self.moment[..., None] - 0.5 * (n - 1) * self.total[..., None]) / (
            n * (n * float(n) - 1.0) / 12.0
        )
        return mean - 0.5 * (n - 1) * slope, slope

    def sums_without_end(self, lag: int) -> tuple[Floats, Floats]:
        """sum(x_k) and sum(k x_k) over k < N - t, for t = 0..lag: (lag + 1,) or (n, lag + 1)."""
        k = np.arange(self.length - 1, self.length - 1 - lag, -1.0)
        last = self.tail[..., ::-1][..., :lag]
        return self.total[..., None] - _running(last), self.moment[..., None] - _running(k * last)

    def sums_without_start(self, lag: int) -> tuple[Floats, Floats]:
        """sum(x_k) and sum((k - t) x_k) over k >= t, for t = 0..lag."""
        first = self.head[..., :lag]
        total = self.total[..., None] - _running(first)
        return (
            total,
            self.moment[..., None]
            - _running(np.arange(float(lag)) * first)
            - np.arange(lag + 1.0) * total,
        )


NO_SAMPLES = Moments(0, np.zeros(()), np.zeros(()), np.empty(0), np.empty(0))


def line_products(late: Moments, early: Moments, lag: int) -> Floats:
    """(1/N) sum of what their lines add to late_{k+t} early_k, for t = 0..lag: subtract it from
    the raw covariance.
    """
    n = early.length
    t = np.arange(lag + 1.0)
    (late_start, late_slope), (early_start, early_slope) = late.line(), early.line()
    early_0, early_1 = early.sums_without_end(lag)
    late_0, late_1 = late.sums_without_start(lag)
    count = n - t
    k1 = count * (count - 1) / 2
    k2 = (count - 1) * count * (2 * count - 1) / 6
    shifted = late_start + late_slope * t
    line_by_signal = (
        shifted * early_0 + late_slope * early_1 + early_start * late_0 + early_slope * late_1
    )
    line_by_line = (
        shifted * early_start * count
        + (shifted * early_slope + late_slope * early_start) * k1
        + late_slope * early_slope * k2
    )
    return np.asarray((line_by_signal - line_by_line) / n)


def _running(values: Floats) -> Floats:
    found = np.zeros((*values.shape[:-1], values.shape[-1] + 1))
    np.cumsum(values, axis=-1, out=found[..., 1:])
    return found
