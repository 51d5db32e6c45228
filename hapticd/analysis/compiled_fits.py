"""`local_fits` in numba: normal equations from moments that neighbouring frequencies share.

Every column of a fit is a power of r times one of the sequences V, 1 and G_k = bin F(bin + k
servo), k = 0 .. K, so all its products are moments

    m_p(a, b) = sum r^p conj(a) b

with p = 0 .. 4 between V and 1, 0 .. 2 between one of them and a G, 0 between two G. Windows
overlap six times. Between two neighbouring ends of windows all bins belong to the same ones: the
moments of such a block are summed once, about its own middle, and moved to the place of each window
by the binomial theorem; |r| <= 1 keeps their digits.

The equations are solved by Cholesky's factor R of the columns with the force behind them. With q0
as the last column its variance per unit of noise is 1 / R[q,q]^2, and the last pivot is the force
that is not explained.

What would break it: that pivot is y^2 less what is explained, so it is known to 1e-15 of y^2 alone;
`local_fits` in numpy, which sums what is left, knows more where nothing is left.
"""

from functools import lru_cache
from itertools import combinations_with_replacement, product
from math import comb

import numba
import numpy as np

from hapticd.analysis.arrays import Integers
from hapticd.analysis.local_fits import ORDER, RIDGE, TERMS, TINY, Fit, Transforms

_SUMS = {"contract", "reassoc", "nsz"}
# sequences; those of the images follow
_V = 0
_ONE = 1
_FORCE = 2
_ONES = 2  # the pair of 1 with itself
_POWERS = 2 * ORDER + 1
_BINOMIAL = np.array([[comb(p, i) for i in range(_POWERS)] for p in range(_POWERS)], np.float64)
_LEAST = float(np.finfo(np.float64).eps)  # of the force: what rounding leaves unexplained


def local_fits(whole: Transforms, places: Integers, fit: Fit) -> None:
    """See `local_fits.local_fits`."""
    first = np.maximum(places - whole.half, 1)
    last = np.minimum(places + whole.half + 1, whole.velocity.size)
    borders = np.union1d(first, last)
    begin = np.searchsorted(borders, first)
    end = np.searchsorted(borders, last)
    pairs, high = _pairs(_FORCE + 1 + whole.shifts.size)
    _fits(
        whole.force, whole.velocity, whole.samples, whole.half, whole.shifts,
        pairs, high, _columns(whole.shifts.size), places, borders, begin, end,
        fit.z, fit.variance, fit.power, fit.ends,
    )  # fmt: skip


@lru_cache
def _pairs(sequences: int) -> tuple[Integers, Integers]:
    """Those (n, 2) of sequences that are multiplied, V and 1 with each other first, then one of
    them with a G, then two of G; and how many of them need the power p, (5,).
    """
    plain = [(_V, _V), (_V, _ONE), (_ONE, _ONE)]
    mixed = list(product((_V, _ONE), range(_FORCE, sequences)))
    forces = list(combinations_with_replacement(range(_FORCE, sequences), 2))
    some = len(plain) + len(mixed)
    return np.array(plain + mixed + forces), np.array([some + len(forces), some, some, 3, 3])


@lru_cache
def _columns(images: int) -> Integers:
    """Sequence and power of each (n, 2): images, the rest of Q, J, then q0 and the force."""
    shifted = [(_FORCE + 1 + k, 0) for k in range(images)]
    slopes = [(_V, power) for power in range(1, TERMS)]
    ends = [(_ONE, power) for power in range(TERMS)]
    return np.array([*shifted, *slopes, *ends, (_V, 0), (_FORCE, 0)])


@numba.njit(nogil=True, cache=True)
def _fits(  # type: ignore[no-untyped-def]
    force, velocity, samples, half, shifts,
    pairs, high, columns, places, borders, begin, end,
    z, variance, power, ends,
):  # fmt: skip
    """The same; bins `borders[begin]` .. `borders[end]` - 1 are those about a place."""
    rows = np.empty((2, _FORCE + 1 + shifts.size, 2 * half + 1))
    work = np.empty((3, 2 * half + 1))
    blocks = np.zeros((borders.size, _POWERS, len(pairs)), np.complex128)
    moments = np.empty((_POWERS, len(pairs)), np.complex128)
    known = 0
    for i in range(places.size):
        for block in range(max(known, begin[i]), end[i]):
            _gather(force, velocity, samples, shifts, borders[block], borders[block + 1], rows)
            _sum(rows, borders[block + 1] - borders[block], half, pairs, high, work, blocks[block])
        known = end[i]
        moments[:] = 0.0
        for block in range(begin[i], end[i]):
            middle = 0.5 * (borders[block] + borders[block + 1] - 1)
            _move(blocks[block], (middle - places[i]) / half, high, moments)
        count = borders[end[i]] - borders[begin[i]]
        power[i] = moments[0, 0].real / count
        _solve(moments, pairs, columns, count, i, z, variance, ends)
        z[i] /= places[i]
        variance[i] /= float(places[i]) ** 2


@numba.njit(cache=True)
def _gather(force, velocity, samples, shifts, first, last, rows):  # type: ignore[no-untyped-def]
    """Real and imaginary parts of the sequences at bins `first` .. `last` - 1 to `rows`."""
    for i in range(last - first):
        place = first + i
        rows[0, _V, i] = velocity[place].real
        rows[1, _V, i] = velocity[place].imag
        rows[0, _ONE, i] = 1.0
        rows[1, _ONE, i] = 0.0
        rows[0, _FORCE, i] = place * force[place].real
        rows[1, _FORCE, i] = place * force[place].imag
    for k in range(shifts.size):
        for i in range(last - first):
            there = (first + i + shifts[k]) % samples
            mirrored = samples - there
            value = force[there] if there < mirrored else force[mirrored].conjugate()
            rows[0, _FORCE + 1 + k, i] = (first + i) * value.real
            rows[1, _FORCE + 1 + k, i] = (first + i) * value.imag


@numba.njit(fastmath=_SUMS, cache=True)
def _sum(rows, count, half, pairs, high, work, moments):  # type: ignore[no-untyped-def]
    """`moments` (5, n) of a block of `count` bins about its middle, in units of `half`."""
    away, real, imag = work
    for i in range(count):
        away[i] = (i - 0.5 * (count - 1)) / half
    for pair in range(len(pairs)):
        a_real = rows[0, pairs[pair, 0]]
        a_imag = rows[1, pairs[pair, 0]]
        b_real = rows[0, pairs[pair, 1]]
        b_imag = rows[1, pairs[pair, 1]]
        for i in range(count):
            real[i] = a_real[i] * b_real[i] + a_imag[i] * b_imag[i]
            imag[i] = a_real[i] * b_imag[i] - a_imag[i] * b_real[i]
        for p in range(_POWERS):
            if pair < high[p]:
                moments[p, pair] = _total(real, imag, away, count)


@numba.njit(fastmath=_SUMS, cache=True)
def _total(real, imag, away, count):  # type: ignore[no-untyped-def]
    """Sum of a sequence, which is then multiplied by r."""
    sum_real = 0.0
    sum_imag = 0.0
    for i in range(count):
        sum_real += real[i]
        sum_imag += imag[i]
        real[i] *= away[i]
        imag[i] *= away[i]
    return complex(sum_real, sum_imag)


@numba.njit(fastmath=_SUMS, cache=True)
def _move(block, distance, high, moments):  # type: ignore[no-untyped-def]
    """Add moments of a block to those about a place that is `distance` below its middle."""
    for p in range(_POWERS):
        factor = 1.0
        for i in range(p, -1, -1):
            weight = _BINOMIAL[p, i] * factor
            for pair in range(high[p]):
                moments[p, pair] += weight * block[i, pair]
            factor *= distance


@numba.njit(fastmath=_SUMS, cache=True)
def _solve(moments, pairs, columns, count, i, z, variance, ends):  # type: ignore[no-untyped-def]
    """Of one frequency, for a force that is multiplied by its bins."""
    force = len(columns) - 1
    q = force - 1
    root, size = _normal(moments, pairs, columns)
    _factor(root)
    found = _coefficients(root)
    left = root[force, force].real ** 2 - RIDGE * (found.real**2 + found.imag**2).sum()
    freedom = max(count - force, 1)
    scale = size[force] / size[q]
    z[i] = scale * found[q]
    variance[i] = scale**2 * max(left, _LEAST) / (freedom * root[q, q].real ** 2)
    ends[i] = _power(found[q - TERMS : q] / size[q - TERMS : q], moments)


@numba.njit(fastmath=_SUMS, cache=True)
def _normal(moments, pairs, columns):  # type: ignore[no-untyped-def]
    """Upper half of the products of all columns of size 1, with a ridge, and their sizes."""
    n = len(columns)
    sequences = columns[:, 0].max() + 1
    index = np.empty((sequences, sequences), np.int64)
    for pair in range(len(pairs)):
        index[pairs[pair, 0], pairs[pair, 1]] = pair
    products = np.zeros((n, n), np.complex128)
    size = np.empty(n)
    for d in range(n):
        for c in range(d + 1):
            a = columns[c, 0]
            b = columns[d, 0]
            p = columns[c, 1] + columns[d, 1]
            value = moments[p, index[a, b]] if a <= b else moments[p, index[b, a]].conjugate()
            products[c, d] = value
        size[d] = max(np.sqrt(max(products[d, d].real, 0.0)), TINY)
    for d in range(n):
        for c in range(d + 1):
            products[c, d] /= size[c] * size[d]
        products[d, d] += RIDGE if d < n - 1 else 0.0
    return products, size


@numba.njit(fastmath=_SUMS, cache=True)
def _factor(products):  # type: ignore[no-untyped-def]
    """Cholesky's factor R in place of the upper half of R^H R."""
    n = len(products)
    for j in range(n):
        for i in range(j):
            value = products[i, j]
            for k in range(i):
                value -= products[k, i].conjugate() * products[k, j]
            products[i, j] = value / products[i, i].real
        pivot = products[j, j].real
        for k in range(j):
            pivot -= products[k, j].real ** 2 + products[k, j].imag ** 2
        products[j, j] = np.sqrt(max(pivot, RIDGE if j < n - 1 else 0.0))


@numba.njit(fastmath=_SUMS, cache=True)
def _coefficients(root):  # type: ignore[no-untyped-def]
    """Of all columns (n - 1,) in the last one."""
    n = len(root) - 1
    found = np.empty(n, np.complex128)
    for c in range(n - 1, -1, -1):
        value = root[c, n]
        for d in range(c + 1, n):
            value -= root[c, d] * found[d]
        found[c] = value / root[c, c].real
    return found


@numba.njit(fastmath=_SUMS, cache=True)
def _power(polynomial, moments):  # type: ignore[no-untyped-def]
    """Sum of the squares of J, of `size` 1 of the force."""
    total = 0.0
    for a in range(TERMS):
        for b in range(TERMS):
            both = polynomial[a].conjugate() * polynomial[b]
            total += both.real * moments[a + b, _ONES].real
    return total
