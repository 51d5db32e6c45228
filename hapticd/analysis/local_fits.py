"""Q and J of `resolved` about each of F frequencies: least squares in numpy, as they are defined.

About the bin p of a record, with r = (bin - p) / half from -1 to 1 and x = bin / p,

    x F = (q0 + q1 r + q2 r^2) V + (j0 + j1 r + j2 r^2) + sum_k g_k x F(bin + k servo)

is solved over the bins p - half .. p + half, as far as there are such: Z is q0. `compiled` does the
same where numba is there, from sums that neighbouring frequencies share; this is what it is checked
against.

By einsum, not BLAS: its threads wait for each other where every core has a trial of its own, and
its last bits depend on the number of cores.

What would break it: columns that are the same to rounding, as where all of a motion is in one bin;
`RIDGE` then leaves numbers, of which the variance says that nothing is known.
"""

from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Complexes, Floats, Integers

ORDER = 2  # of both polynomials
TERMS = ORDER + 1
TOGETHER = 16  # frequencies at once: 1 MB
TINY = float(np.finfo(np.float64).tiny) ** 0.5
RIDGE = 1e-14  # of a column's power: a channel without power leaves numbers


@dataclass(frozen=True, eq=False)
class Fit:
    """About F frequencies: `z` [N s/m] with its `variance`, the mean `power` of V, and `ends`, the
    power of J over that of the force.
    """

    z: Complexes
    variance: Floats
    power: Floats
    ends: Floats

    @staticmethod
    def empty(size: int) -> "Fit":
        """Room for so many."""
        return Fit(np.empty(size, np.complex128), np.empty(size), np.empty(size), np.empty(size))

    def part(self, which: slice) -> "Fit":
        """Views of some of them."""
        return Fit(self.z[which], self.variance[which], self.power[which], self.ends[which])


@dataclass(frozen=True, eq=False)
class Transforms:
    """Of a record of `samples`: `force` and `velocity`, both (samples/2 + 1,).

    A fit takes `half` bins on each side; `shifts` (K,) are those from a frequency to its images,
    in bins.
    """

    force: Complexes
    velocity: Complexes
    samples: int
    half: int
    shifts: Integers


def local_fits(whole: Transforms, places: Integers, fit: Fit) -> None:
    """Fill `fit` about the bins `places` (F,), ascending from 1."""
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
    """The force at the images of bins `at` (F, n), (F, K, n)."""
    there = (at[:, None] + whole.shifts[:, None]) % whole.samples
    mirrored = there > whole.samples // 2
    found = whole.force[np.where(mirrored, whole.samples - there, there)]
    return np.where(mirrored, found.conj(), found)


def _least_squares(columns: Complexes, y: Complexes, count: Integers, fit: Fit) -> None:
    """Of `y` (F, n) by `columns` (F, c, n), Q's first, then J's; `count` (F,) bins."""
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
    with np.errstate(over="ignore"):  # no power: nothing is known
        fit.variance[:] = left / freedom * inverse[:, 0, 0].real / size[:, 0] ** 2
    fit.ends[:] = _power(ends) / np.maximum(_power(y), TINY)


def _power(values: Complexes) -> Floats:
    """Sum of the squares of (F, n)."""
    return np.asarray((values.real**2 + values.imag**2).sum(axis=1))
