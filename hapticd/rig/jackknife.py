"""Least squares of a record in blocks, each of which is left out once (jackknife).

An equation that holds at every sample of a record holds for the Fourier lines of each block of it
as well. Least squares over all blocks give the values. Leaving out each block in turn gives their
deviations and correlations, without presuming that residuals are white or of one size (Tukey 1958).

What would break it: residuals that go together over more than a block (intervals too narrow).
"""

from typing import NamedTuple

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.core.errors import AnalysisError


def lines(values: Floats, block: int, rate_hz: float, band_hz: tuple[float, float]) -> Floats:
    """Real and imaginary parts (blocks, 2 l) of `values` (n,) at l lines of each block."""
    count = values.size // block
    parts = values[: count * block].reshape(count, block)
    window = np.hanning(block)
    f = np.fft.rfftfreq(block, 1.0 / rate_hz)
    found = np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * window, axis=1)
    kept = found[:, (f >= band_hz[0]) & (f <= band_hz[1])]
    return np.concatenate((kept.real, kept.imag), axis=1)


class Solution(NamedTuple):
    """Least squares by blocks."""

    values: Floats  # (p,)
    left: Floats  # (blocks, p) with each block left out

    @property
    def covariance(self) -> Floats:
        """(p, p) by the jackknife."""
        away = self.left - self.left.mean(axis=0)
        blocks = len(self.left)
        return np.asarray((blocks - 1) / blocks * (away.T @ away))

    @property
    def sd(self) -> Floats:
        """(p,)"""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def solved(columns: Floats, target: Floats) -> Solution:
    """`target` (blocks, rows) by `columns` (blocks, rows, p). AnalysisError where these are no
    motion at all.
    """
    scale = np.sqrt((columns**2).sum(axis=(0, 1)))
    if not (scale > 0.0).all():
        raise AnalysisError(
            "nothing moved: is the perturbation connected, and stronger than friction?"
        )
    even = columns / scale
    normal = np.einsum("bri,brj->bij", even, even)
    right = np.einsum("bri,br->bi", even, target)
    whole = np.linalg.solve(normal.sum(axis=0), right.sum(axis=0))
    left = np.linalg.solve(normal.sum(axis=0) - normal, (right.sum(axis=0) - right)[..., None])
    return Solution(whole / scale, left[..., 0] / scale)
