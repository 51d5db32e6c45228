"""Covariances of a long record from short transforms, and the inner loops over records.

Sections (Rader 1970, "An improved algorithm for high speed autocorrelation"). The record is cut
into sections of M samples, each padded with zeros to 2 M and transformed once. Lags 0..M of section
i with the following record need only sections i and i + 1. A shift of section i + 1 by M samples is
a factor (-1)^k on bin k. Summing conj(U_i) (Y_i + (-1)^k Y_{i+1}) over all sections and one inverse
transform at the end give the exact biased covariances. The method needs memory O(M) and takes a
record of any length in pieces of any size. It takes about 43 Mflop for 360,000 samples; direct sums
take 1.5 Gflop.

Trends. The paper (Weir, Colgate and Peshkin 2008, section 2.2) detrends the whole record before
`spa`. With t = k - (N - 1)/2 the least-squares line is mean + slope t, slope = sum(t x) / (N (N^2 -
1) / 12): two passes, no equations to solve. A stream cannot be read twice. It sums raw products and
removes the lines from the covariances afterwards (`line_products`). The products of a signal with a
line need only the totals sum(x) and sum(k x) and the first and last M samples.

The lag must not change while sums are kept. Blocks of unequal length in the two channels are
refused. Limitations: in a stream, an offset about 10^6 times the motion leaves no significant
digits.

Inner loops. `kernels` returns those of `compiled` if numba is installed, otherwise those of this
module. Both sets take the same arguments and agree to rounding; tests compare the compiled ones
with these. No other module of the package needs a compiler.

    fitted_line, take_line_out    the linear trend of a signal
    accumulate                    spectral sums of neighbouring sections
    local_fits                    Q and J of `resolved` about each of F frequencies

About the bin p of a record, with r = (bin - p) / half from -1 to 1 and x = bin / p, `local_fits`
solves

    x F = (q0 + q1 r + q2 r^2) V + (j0 + j1 r + j2 r^2) + sum_k g_k x F(bin + k servo)

by least squares over those of the bins p - half .. p + half that exist: Z is q0. It uses einsum,
not BLAS. BLAS threads wait for each other where every core has a trial of its own. The last bits of
BLAS depend on the number of cores.

Limitations: columns that are equal to rounding, as where all motion is in one bin. `RIDGE` then
yields numbers with a variance that marks them as unknown.
"""

import sys
from dataclasses import dataclass
from functools import cache, lru_cache
from types import ModuleType

import numpy as np
from numpy.polynomial import Polynomial

from hapticd.core.arrays import Complexes, Floats, Integers, alternating, lazy_property
from hapticd.core.errors import AnalysisError

# --- inner loops ----------------------------------------------------------------------------------
ORDER = 2  # of both polynomials
TERMS = ORDER + 1
FREQUENCIES_TOGETHER = 16  # frequencies at once: 1 MB
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
    for first in range(0, places.size, FREQUENCIES_TOGETHER):
        some = slice(first, first + FREQUENCIES_TOGETHER)
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


# --- covariances ----------------------------------------------------------------------------------
TOGETHER = 32_768  # samples transformed together: their spectra stay in the second-level cache


def detrended(signal: Floats) -> Floats:
    """Return `signal` (N,) float64 without its least-squares line, in a new array, as MATLAB's
    `detrend(x, 1)`.
    """
    out = np.empty(signal.size)
    kernels().take_line_out(signal, *kernels().fitted_line(signal), out)
    return out


@dataclass(frozen=True)
class Moments:
    """Summary of a signal from which its trend can be removed later.

    For many signals of one length, `total` and `moment` are (n,), `head` and `tail` (n, samples).
    """

    length: int  # samples N
    total: Floats  # sum of x_k, unit of the signal
    moment: Floats  # sum of k x_k
    head: Floats  # first samples
    tail: Floats  # last samples

    def extended(self, block: Floats, keep: int) -> "Moments":
        """Return the moments with `block` appended; `keep` samples are kept at each end."""
        k = np.arange(self.length, self.length + block.size, dtype=np.float64)
        missing = max(0, keep - self.head.size)
        return Moments(
            self.length + block.size,
            self.total + block.sum(),
            self.moment
            + (k * block).sum(),  # the last bits of a BLAS product depend on the number of cores
            np.concatenate((self.head, block[:missing])),
            np.concatenate((self.tail, block))[-keep:],
        )

    @lazy_property
    def line(self) -> tuple[Floats, Floats]:
        """Value at k = 0 and slope per sample of the least-squares line, (1,) or (n, 1)."""
        n = self.length
        mean = self.total[..., None] / n
        slope = (self.moment[..., None] - 0.5 * (n - 1) * self.total[..., None]) / (
            n * (n * float(n) - 1.0) / 12.0
        )
        return mean - 0.5 * (n - 1) * slope, slope

    @lazy_property
    def leaving(self) -> "Running":
        """Sums over the last samples, backwards from the end."""
        return Running.of(self.tail[..., ::-1])

    @lazy_property
    def entering(self) -> "Running":
        """Sums over the first samples."""
        return Running.of(self.head)


@dataclass(frozen=True)
class Running:
    """Sums over the first t of some samples x_0, x_1, ..., for t = 0, 1, ...: (samples + 1,) or
    (n, samples + 1).
    """

    once: Floats  # sum of x_j over j < t
    twice: Floats  # sum of (t - j) x_j over j < t

    @classmethod
    def of(cls, samples: Floats) -> "Running":
        """Sums over `samples`, (samples,) or (n, samples)."""
        sums = np.zeros((2, *samples.shape[:-1], samples.shape[-1] + 1))
        np.cumsum(samples, axis=-1, out=sums[0, ..., 1:])
        np.cumsum(sums[0, ..., 1:], axis=-1, out=sums[1, ..., 1:])
        return cls(sums[0], sums[1])


NO_SAMPLES = Moments(0, np.zeros(()), np.zeros(()), np.empty(0), np.empty(0))


def line_products(late: Moments, early: Moments, lag: int) -> Floats:
    """Return the contribution of the lines of both signals to (1/N) sum late_{k+t} early_k, for t =
    0..lag, (lag + 1,) or (n, lag + 1). Subtract it from the raw covariance.

    With the lines p + q k of `late` and r + s k of `early`, it is the sum over k < N - t of

        (p + q (k + t)) early_k + late_{k+t} (r + s k) - (p + q (k + t)) (r + s k)

    a cubic in t, minus the contributions of the last t samples of `early` and the first t of
    `late`.
    """
    n = early.length
    p, q = late.line
    r, s = early.line
    ahead = early.leaving
    behind = late.entering
    found = _of_whole_lines(late, early, lag)
    found -= (p + q * (n - 1)) * ahead.once[..., : lag + 1]
    found -= q * ahead.twice[..., : lag + 1]
    found -= r * behind.once[..., : lag + 1]
    found += s * behind.twice[..., : lag + 1]
    return np.asarray(found / n)


def _of_whole_lines(late: Moments, early: Moments, lag: int) -> Floats:
    """Return the cubic of `line_products`, as if no sample of either signal were left out."""
    p, q = late.line
    r, s = early.line
    late_total = late.total[..., None]
    early_total = early.total[..., None]
    factors = (
        p * early_total + q * early.moment[..., None] + r * late_total + s * late.moment[..., None],
        q * early_total - s * late_total,
        -p * r,
        -q * r,
        -p * s,
        -q * s,
    )
    factor = np.stack(np.broadcast_arrays(*factors), axis=-1)[..., 0, :]  # (6,) or (n, 6)
    # not a BLAS product, whose last bits may depend on the number of cores
    cubic = np.einsum("...i,ji->...j", factor, _sums_over_overlap(early.length))
    return np.asarray(np.einsum("...j,jt->...t", cubic, _powers(lag)))


@lru_cache(maxsize=8)
def _powers(lag: int) -> Floats:
    """t^0..t^3 for t = 0..lag, (4, lag + 1)."""
    return np.vander(np.arange(lag + 1.0), 4, increasing=True).T.copy()


@lru_cache(maxsize=8)
def _sums_over_overlap(n: int) -> Floats:
    """Coefficients of t^0..t^3 (4, 6), a row for each power. The columns are 1 and t, and the sums
    over k < n - t of 1, of k + t, of k, and of (k + t) k.
    """
    t = Polynomial([0.0, 1.0])
    count = n - t
    k = count * (count - 1.0) / 2.0
    k2 = (count - 1.0) * count * (2.0 * count - 1.0) / 6.0
    columns = (Polynomial([1.0]), t, count, t * count + k, k, t * k + k2)
    found = np.zeros((4, len(columns)))
    for place, column in enumerate(columns):
        found[: column.coef.size, place] = column.coef
    return found


@dataclass(frozen=True)
class Covariances:
    """Biased covariances (1/N) for lags t = 0..M, each (M + 1,) float64."""

    velocity: Floats  # R_u, (m/s)^2
    force: Floats  # R_y, N^2
    forward: Floats  # R_yu(t) = 1/N sum y(k + t) u(k), N m/s
    backward: Floats  # R_yu(-t), N m/s
    n_samples: int


class Sections:
    """Spectral sums over a record that arrives in blocks. `covariances()` may be called at any time
    and does not change them.
    """

    def __init__(self, lag: int) -> None:
        self.lag = lag
        self.n_samples = 0
        self._together = max(1, TOGETHER // lag)
        self._sums = np.zeros((4, lag + 1), np.complex128)
        self._waiting = np.zeros((2, 0))  # an incomplete section of velocity and force
        self._padded = np.zeros((self._together, 2 * lag))
        self._spectra = np.zeros(
            (2, self._together + 1, lag + 1), np.complex128
        )  # row 0: the section before, initially zero

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
        """Return the covariances of all samples so far, with their trends. AnalysisError without
        samples.
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
        """Complete the pending section, and return the number of samples taken from the block."""
        held = self._waiting.shape[1]
        missing = self.lag - held if held else 0
        if force.size < missing:
            return 0  # the whole block is pending
        if held:
            section = np.concatenate((self._waiting, (velocity[:missing], force[:missing])), axis=1)
            self._take([section[:1], section[1:]])
            self._waiting = np.zeros((2, 0))
        return missing

    def _take(self, rows: list[Floats]) -> None:
        """Add sections (n, M) of velocity and force to the sums, n up to `_together`."""
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
    """Raise AnalysisError unless both are (n,)."""
    if force.ndim != 1 or force.shape != velocity.shape:
        raise AnalysisError(
            f"force {force.shape} and velocity {velocity.shape}: two records of one length are"
            " needed"
        )
