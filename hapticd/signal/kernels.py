"""The inner loops over records in numpy, and the choice between them and the compiled ones.

`kernels()` returns the loops of `compiled` if numba is installed, otherwise those below. Both sets
take the same arguments and agree to rounding; tests compare the compiled ones with these. No other
module of the package needs a compiler.

    fitted_line, take_line_out    the linear trend of a signal (`covariances`)
    accumulate                    spectral sums of neighbouring sections (`covariances`)
    local_fits                    Q and J of `resolved` about each of F frequencies

About the bin p of a record, with r = (bin - p) / half from -1 to 1 and x = bin / p, `local_fits`
solves

    x F = (q0 + q1 r + q2 r^2) V + (j0 + j1 r + j2 r^2) + sum_k g_k x F(bin + k servo)

by least squares over those of the bins p - half .. p + half that exist: Z is q0. It uses einsum,
not BLAS. BLAS threads wait for each other where every core has a trial of its own, and the last
bits of BLAS depend on the number of cores.

Limitations: columns that are equal to rounding, as where all motion is in one bin. `RIDGE` then
yields numbers with a variance that marks them as unknown.
"""

import sys
from dataclasses import dataclass
from functools import cache
from types import ModuleType

import numpy as np

from hapticd.core.arrays import Complexes, Floats, Integers, alternating

ORDER = 2  # of both polynomials
TERMS = ORDER + 1
TOGETHER = 16  # frequencies at once: 1 MB
TINY = float(np.finfo(np.float64).tiny) ** 0.5
RIDGE = 1e-14  # of a column's power: keeps a channel without power finite
_BLOCK = 16_384  # samples at once: their indices stay in the cache


@dataclass(frozen=True, eq=False)
class Fit:
    """Results of local fits about F frequencies."""

    z: Complexes  # (F,) N s/m
    variance: Floats  # (F,) of z, (N s/m)^2
    power: Floats  # (F,) mean of |V|^2
    ends: Floats  # (F,) power of J over that of the force

    @staticmethod
    def empty(size: int) -> "Fit":
        """Room for the results about `size` frequencies."""
        return Fit(np.empty(size, np.complex128), np.empty(size), np.empty(size), np.empty(size))

    def part(self, which: slice) -> "Fit":
        """Views of the results about some of the frequencies."""
        return Fit(self.z[which], self.variance[which], self.power[which], self.ends[which])


@dataclass(frozen=True, eq=False)
class Transforms:
    """Transforms of a whole record, and the settings of a fit."""

    force: Complexes  # (samples/2 + 1,) N
    velocity: Complexes  # (samples/2 + 1,) m/s
    samples: int  # of the record
    half: int  # bins on each side of a fit
    shifts: Integers  # (K,) bins from a frequency to its images


def local_fits(whole: Transforms, places: Integers, fit: Fit) -> None:
    """Fill `fit` about the ascending bins `places` (F,), from 1."""
    for first in range(0, places.size, TOGETHER):
        some = slice(first, first + TOGETHER)
        _fit(whole, places[some], fit.part(some))


def _fit(whole: Transforms, places: Integers, fit: Fit) -> None:
    reach = np.arange(-whole.half, whole.half + 1)
    bins = places[:, None] + reach
    inside = (bins > 0) & (bins < whole.velocity.size)
    at = np.where(inside, bins, 0)
    v = inside * whole.velocity[at]
    rising = inside * (bins / places[:, None])
    y = rising * whole.force[at]
    powers = (reach / whole.half) ** np.arange(TERMS)[:, None]
    parts = (
        v[:, None] * powers,
        inside[:, None] * powers,
        rising[:, None] * _images(whole, at),
    )
    columns = np.concatenate(parts, axis=1, dtype=np.complex128)
    count = inside.sum(axis=1)
    fit.power[:] = _power(v) / count
    _least_squares(columns, y, count, fit)


def _images(whole: Transforms, at: Integers) -> Complexes:
    """The force at the images of bins `at` (F, n): (F, K, n)."""
    there = (at[:, None] + whole.shifts[:, None]) % whole.samples
    mirrored = there > whole.samples // 2
    found = whole.force[np.where(mirrored, whole.samples - there, there)]
    return np.where(mirrored, found.conj(), found)


def _least_squares(columns: Complexes, y: Complexes, count: Integers, fit: Fit) -> None:
    """Fit `columns` (F, c, n), those of Q first, then those of J, to `y` (F, n); `count` (F,) bins
    exist.
    """
    conjugate = columns.conj()
    normal = np.einsum("fcn,fdn->fcd", conjugate, columns)
    size = np.maximum(np.sqrt(np.einsum("fcc->fc", normal).real), TINY)
    normal /= size[:, :, None] * size[:, None, :]
    inverse = np.linalg.inv(normal + RIDGE * np.eye(columns.shape[1]))
    wanted = np.einsum("fcn,fn->fc", conjugate, y) / size
    found = np.einsum("fcd,fd->fc", inverse, wanted) / size
    left = _power(y - np.einsum("fc,fcn->fn", found, columns))
    ends = np.einsum("fc,fcn->fn", found[:, TERMS : 2 * TERMS], columns[:, TERMS : 2 * TERMS])
    freedom = np.maximum(count - columns.shape[1], 1)
    fit.z[:] = found[:, 0]
    with np.errstate(over="ignore"):  # no power: z is unknown
        fit.variance[:] = left / freedom * inverse[:, 0, 0].real / size[:, 0] ** 2
    fit.ends[:] = _power(ends) / np.maximum(_power(y), TINY)


def _power(values: Complexes) -> Floats:
    """Sum of the squares of each row of (F, n)."""
    return np.asarray((values.real**2 + values.imag**2).sum(axis=1))


@cache
def kernels() -> ModuleType:
    """Return the module of the compiled loops, or this one if numba is not installed."""
    try:
        from hapticd.signal import compiled
    except ImportError:
        return sys.modules[__name__]
    return compiled


def fitted_line(signal: Floats) -> tuple[float, float]:
    """Return value at the first sample and slope per sample of the least-squares line through
    `signal` (N,), N >= 2.
    """
    n = signal.size
    middle = 0.5 * (n - 1)
    moment = sum(
        float(
            np.arange(start - middle, min(start + _BLOCK, n) - middle)
            @ signal[start : start + _BLOCK]
        )
        for start in range(0, n, _BLOCK)
    )
    slope = moment / (n * (float(n) * n - 1.0) / 12.0)
    return float(signal.mean()) - slope * middle, slope


def take_line_out(signal: Floats, value: float, slope: float, out: Floats) -> None:
    """Write `signal` (n,) minus the line with `value` at the first sample and `slope` per sample to
    `out`.
    """
    np.subtract(signal, value + slope * np.arange(signal.size), out=out)


def accumulate(velocity: Complexes, force: Complexes, sums: Complexes) -> None:
    """Add conj(first) (first + second) of neighbouring sections to `sums` (4, M + 1).

    `velocity`, `force`: (sections, M + 1) spectra of sections padded to 2 M. Rows of `sums`:
    velocity, force, force after velocity, velocity after force. A delay by M samples is a factor
    (-1)^k on bin k.
    """
    sign = alternating(velocity.shape[1])
    u = velocity[:-1].conj()
    y = force[:-1].conj()
    later_u = velocity[:-1] + sign * velocity[1:]
    later_y = force[:-1] + sign * force[1:]
    for row, (first, second) in enumerate(((u, later_u), (y, later_y), (u, later_y), (y, later_u))):
        sums[row] += np.einsum("ij,ij->j", first, second)
