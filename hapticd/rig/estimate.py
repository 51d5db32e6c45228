"""Weighted least squares, and the 95 % intervals of the estimates.

`least_squares` fits independent rows: the residuals give the variance, and Student's t the
interval. `separable` fits a few additional unknowns in which the columns are nonlinear
(Gauss-Newton).

A record is cut into blocks instead, each of which is left out once (`jackknife`, Tukey 1958). This
gives deviations and correlations without assuming that residuals are white or of equal size. An
equation that holds at every sample also holds for the Fourier lines of each block (`lines`).

Limitations: residuals that are correlated over more than a block give intervals that are too
narrow.
"""

from collections.abc import Callable
from math import hypot, sqrt
from typing import NamedTuple

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.core.errors import AnalysisError
from hapticd.rig.result import Value
from hapticd.signal.verdict import student_quantile

UPPER_END = 0.975  # share of a distribution below the upper end of its 95 % interval
NORMAL = 1.96  # standard deviations to that end, of a normal distribution
NEXT_TO_NOTHING = 1e-12  # of the largest singular value


class Fit(NamedTuple):
    """Coefficients (p,) with their covariance (p, p) and its degrees of freedom."""

    values: Floats
    covariance: Floats
    freedom: float
    residuals: Floats  # weighted

    @property
    def sd(self) -> Floats:
        """Standard deviations (p,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def halves(self) -> Floats:
        """Halves (p,) of the 95 % intervals."""
        return quantile(self.freedom) * self.sd

    def value(self, place: int, name: str, unit: str, relative: float = 0.0) -> Value:
        """Return the coefficient at `place` as the value `name`; `relative` widens its interval."""
        size = float(self.values[place])
        return Value.around(name, size, unit, hypot(float(self.halves[place]), relative * size))

    def half(self, of: Floats) -> float:
        """Return half of the 95 % interval of the sum of `of` (p,) times the coefficients."""
        return quantile(self.freedom) * sqrt(max(0.0, float(of @ self.covariance @ of)))


def quantile(freedom: float) -> float:
    """Return the deviations to the upper end of a 95 % interval with `freedom` degrees."""
    return student_quantile(UPPER_END, freedom)


def least_squares(
    columns: Floats,
    target: Floats,
    weight: Floats | None = None,
    least: float = 0.0,
    inflate: float = 1.0,
) -> Fit:
    """Fit `columns` (n, p) to `target` (n,), each row times `weight` (n,), 1 / its standard
    deviation. The variance is that of the residuals times `inflate`, and at least `least`.
    """
    weight = np.ones(len(target)) if weight is None else weight
    rows = columns * weight[:, None]
    norm = np.linalg.norm(rows, axis=0)
    size = np.where(norm > 0.0, norm, 1.0)
    rows = rows / size
    values = np.linalg.lstsq(rows, target * weight, rcond=NEXT_TO_NOTHING)[0]
    residuals = target * weight - rows @ values
    freedom = max(len(target) - columns.shape[1], 1)
    variance = max(least, inflate * float(residuals @ residuals) / freedom)
    covariance = variance * np.linalg.pinv(rows.T @ rows) / np.outer(size, size)
    return Fit(values / size, covariance, freedom, residuals)


def separable(
    columns_of: Callable[[Floats], Floats],
    target: Floats,
    begin: Floats,
    step: float,
    rounds: int,
    weight: Floats | None = None,
) -> Fit:
    """Fit `columns_of(x)` (n, p) to `target` (n,), with nonlinear unknowns x (q,) starting at
    `begin`. Derivatives are taken over `step`. In the result, the coefficients of the columns come
    before x.
    """
    at = begin
    for _ in range(rounds):
        columns = columns_of(at)
        linear = least_squares(columns, target, weight).values
        slopes = [
            (columns_of(at + one) - columns_of(at - one)) @ linear / (2.0 * step)
            for one in step * np.eye(len(at))
        ]
        left = target - columns @ linear
        fit = least_squares(np.column_stack([columns, *slopes]), left, weight, least=1.0)
        at = at + fit.values[len(linear) :]
    return fit._replace(values=np.append(linear, at))


def line(x: Floats, y: Floats) -> Fit:
    """Fit the line y(x) to (n,) points, n at least 3: its slope, then its intercept."""
    return least_squares(np.column_stack([x, np.ones_like(x)]), y)


def mean_half(values: Floats) -> float:
    """Return half of the 95 % interval of the mean of independent `values` (n,), n at least 2."""
    return quantile(len(values) - 1) * float(values.std(ddof=1)) / sqrt(len(values))


def deviation(name: str, values: Floats, unit: str) -> Value:
    """Return the standard deviation of independent `values` (n,), as the value `name`."""
    found = float(values.std())
    return Value.around(name, found, unit, NORMAL * found / sqrt(2.0 * len(values)))


def jackknife(columns: Floats, target: Floats) -> Fit:
    """Fit `columns` (blocks, rows, p) to `target` (blocks, rows). AnalysisError if a column is all
    zero.
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
    away = left[..., 0] - left[..., 0].mean(axis=0)
    blocks = len(target)
    covariance = (blocks - 1) / blocks * (away.T @ away) / np.outer(scale, scale)
    return Fit(whole / scale, covariance, blocks - 1, target - even @ whole)


def in_blocks(values: Floats, blocks: int) -> Floats:
    """Return `values` (n, ..) as (blocks, rows, ..); a row of zeros pads a block that is a row
    shorter.
    """
    count = len(values)
    block = np.arange(count) * blocks // count
    row = np.arange(count) - np.searchsorted(block, block)
    found = np.zeros((blocks, row.max() + 1, *values.shape[1:]))
    found[block, row] = values
    return found


def lines(values: Floats, block: int, rate_hz: float, band_hz: tuple[float, float]) -> Floats:
    """Return real and imaginary parts (blocks, 2 l) of `values` (n,) at l Fourier lines of each
    block.
    """
    count = values.size // block
    parts = values[: count * block].reshape(count, block)
    window = np.hanning(block)
    f = np.fft.rfftfreq(block, 1.0 / rate_hz)
    found = np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * window, axis=1)
    kept = found[:, (f >= band_hz[0]) & (f <= band_hz[1])]
    return np.concatenate((kept.real, kept.imag), axis=1)
