"""The loops of `covariances` in numba. Only that imports it, and only if numba is installed.

Spectral sums take one pass each, without temporaries. All loops release the interpreter lock, so
trials may run on threads. Sums are reassociated for vector registers: results agree with numpy's to
rounding, not bit for bit.

`local_fits` solves normal equations from moments that neighbouring frequencies share. Every column
of a fit is a power of r times one of the sequences V, 1 and, with k = 0 .. K, G_k = bin F(bin + k
servo), so all its products are moments

    m_p(a, b) = sum r^p conj(a) b

with p = 0 .. 4 between V and 1, 0 .. 2 between one of them and a G, 0 between two G. Windows
overlap six times. Between two neighbouring ends of windows all bins belong to the same windows. The
moments of such a block are summed once, about its own middle, and moved to the place of each window
by the binomial theorem; |r| <= 1 preserves their digits.

The equations are solved by Cholesky's factor R of the columns, with the force last. With q0 as the
last column its variance per unit of noise is 1 / R[q,q]^2. The last pivot is the unexplained force,
y^2 minus the explained part, known to 1e-15 of y^2. Where that is not accurate enough, as without
friction and noise, the residual is summed bin by bin.
"""

from functools import lru_cache
from itertools import combinations_with_replacement, product
from math import comb

import numba
import numpy as np

from hapticd.core.arrays import Integers
from hapticd.signal.covariances import ORDER, RIDGE, TERMS, TINY, Fit, Transforms

# LLVM optimisations allowed in sums; NaN and infinity keep their meaning
_SUMS = {"contract", "reassoc", "nsz"}
# sequences of a fit; those of the images follow
_V = 0
_ONE = 1
_FORCE = 2
_ONES = 2  # the pair of 1 with itself
_POWERS = 2 * ORDER + 1
_BINOMIAL = np.array([[comb(p, i) for i in range(_POWERS)] for p in range(_POWERS)], np.float64)
_CANCELLED = 1e-9  # share of the force below which the residual is summed directly


@numba.njit(fastmath=_SUMS, nogil=True, cache=True)
def fitted_line(signal):  # type: ignore[no-untyped-def]
    """See `covariances.fitted_line`."""
    n = signal.size
    middle = 0.5 * (n - 1)
    total = 0.0
    moment = 0.0
    for i in range(n):
        total += signal[i]
        moment += (i - middle) * signal[i]
    slope = moment / (n * (float(n) * n - 1.0) / 12.0)
    return total / n - slope * middle, slope


@numba.njit(fastmath=_SUMS, nogil=True, cache=True)
def take_line_out(signal, value, slope, out):  # type: ignore[no-untyped-def]
    """See `covariances.take_line_out`."""
    for i in range(signal.size):
        out[i] = signal[i] - (value + slope * i)


@numba.njit(fastmath=_SUMS, nogil=True, cache=True)
def accumulate(velocity, force, sums):  # type: ignore[no-untyped-def]
    """See `covariances.accumulate`."""
    sections, bins = velocity.shape
    for k in range(bins):
        sign = 1 - 2 * (k & 1)
        uu = uy = yu = yy = 0j
        u = velocity[0, k]
        y = force[0, k]
        for i in range(1, sections):
            next_u = velocity[i, k]
            next_y = force[i, k]
            later_u = u + sign * next_u
            later_y = y + sign * next_y
            u = u.conjugate()
            y = y.conjugate()
            uu += u * later_u
            yy += y * later_y
            uy += u * later_y
            yu += y * later_u
            u = next_u
            y = next_y
        sums[0, k] += uu
        sums[1, k] += yy
        sums[2, k] += uy
        sums[3, k] += yu


def local_fits(whole: Transforms, places: Integers, fit: Fit) -> None:
    """See `covariances.local_fits`."""
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
    """Return pairs (n, 2) of sequences to multiply: V and 1 with each other first, then one of them
    with a G, then two G. Also return how many of the pairs need the power p, (5,).
    """
    plain = [(_V, _V), (_V, _ONE), (_ONE, _ONE)]
    mixed = list(product((_V, _ONE), range(_FORCE, sequences)))
    forces = list(combinations_with_replacement(range(_FORCE, sequences), 2))
    some = len(plain) + len(mixed)
    return np.array(plain + mixed + forces), np.array([some + len(forces), some, some, 3, 3])


@lru_cache
def _columns(images: int) -> Integers:
    """Sequence and power of each column, (n, 2): images, the rest of Q, J, then q0 and the
    force.
    """
    shifted = [(_FORCE + 1 + k, 0) for k in range(images)]
    slopes = [(_V, power) for power in range(1, TERMS)]
    ends = [(_ONE, power) for power in range(TERMS)]
    return np.array([*shifted, *slopes, *ends, (_V, 0), (_FORCE, 0)])


# All functions that `_fits` calls are inlined into it. Otherwise they would exist twice, compiled
# alone and within `_fits`. A process that compiles would run the one and a process that loads the
# cache the other, with sums in another order.
@numba.njit(nogil=True, cache=True)
def _fits(  # type: ignore[no-untyped-def]
    force, velocity, samples, half, shifts,
    pairs, high, columns, places, borders, begin, end,
    z, variance, power, ends,
):  # fmt: skip
    """Fit about all places. Place i uses the bins `borders[begin[i]]` .. `borders[end[i]]` - 1."""
    rows = np.empty((_FORCE + 1 + shifts.size, 2, 2 * half + 1))
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
        first = borders[begin[i]]
        last = borders[end[i]]
        root, size = _normal(moments, pairs, columns)
        found, left = _solved(root)
        found *= size[-1] / size[:-1]
        if left < _CANCELLED:
            _gather(force, velocity, samples, shifts, first, last, rows)
            left = (
                _left(rows, columns, found, places[i] - first, last - first, half) / size[-1] ** 2
            )
        freedom = max(last - first - len(found), 1)
        scale = size[-1] / (size[-2] * root[-2, -2].real * places[i])
        z[i] = found[-1] / places[i]
        variance[i] = scale**2 * left / freedom
        power[i] = moments[0, 0].real / (last - first)
        ends[i] = _power(found[-1 - TERMS : -1], moments) / size[-1] ** 2


@numba.njit(forceinline=True)
def _gather(force, velocity, samples, shifts, first, last, rows):  # type: ignore[no-untyped-def]
    """Write real and imaginary parts of the sequences at bins `first` .. `last` - 1 to `rows`."""
    for i in range(last - first):
        place = first + i
        rows[_V, 0, i] = velocity[place].real
        rows[_V, 1, i] = velocity[place].imag
        rows[_ONE, 0, i] = 1.0
        rows[_ONE, 1, i] = 0.0
        rows[_FORCE, 0, i] = place * force[place].real
        rows[_FORCE, 1, i] = place * force[place].imag
    for k in range(shifts.size):
        for i in range(last - first):
            there = (first + i + shifts[k]) % samples
            mirrored = samples - there
            value = force[there] if there < mirrored else force[mirrored].conjugate()
            rows[_FORCE + 1 + k, 0, i] = (first + i) * value.real
            rows[_FORCE + 1 + k, 1, i] = (first + i) * value.imag


@numba.njit(fastmath=_SUMS, forceinline=True)
def _sum(rows, count, half, pairs, high, work, moments):  # type: ignore[no-untyped-def]
    """Sum the `moments` (5, n) of a block of `count` bins about its middle, in units of `half`."""
    away = work[0]
    for i in range(count):
        away[i] = (i - 0.5 * (count - 1)) / half
    for pair in range(len(pairs)):
        a = pairs[pair, 0]
        b = pairs[pair, 1]
        if pair < high[1]:
            _multiply(rows[a], rows[b], work, count)
            for p in range(5 if pair < high[3] else 3):
                moments[p, pair] = _total(work, count)
        else:
            moments[0, pair] = _product(rows[a], rows[b], count)


@numba.njit(fastmath=_SUMS, forceinline=True)
def _product(a, b, count):  # type: ignore[no-untyped-def]
    """Return the sum of conj(a) b."""
    real = 0.0
    imag = 0.0
    for i in range(count):
        real += a[0, i] * b[0, i] + a[1, i] * b[1, i]
        imag += a[0, i] * b[1, i] - a[1, i] * b[0, i]
    return complex(real, imag)


@numba.njit(fastmath=_SUMS, forceinline=True)
def _multiply(a, b, work, count):  # type: ignore[no-untyped-def]
    """Write conj(a) b to `work`."""
    for i in range(count):
        work[1, i] = a[0, i] * b[0, i] + a[1, i] * b[1, i]
        work[2, i] = a[0, i] * b[1, i] - a[1, i] * b[0, i]


@numba.njit(fastmath=_SUMS, forceinline=True)
def _total(work, count):  # type: ignore[no-untyped-def]
    """Return the sum of `work`, and multiply it by r for the next power."""
    real = 0.0
    imag = 0.0
    for i in range(count):
        real += work[1, i]
        imag += work[2, i]
        work[1, i] *= work[0, i]
        work[2, i] *= work[0, i]
    return complex(real, imag)


@numba.njit(fastmath=_SUMS, forceinline=True)
def _move(block, distance, high, moments):  # type: ignore[no-untyped-def]
    """Add the moments of a block to those about a place that is `distance` below its middle."""
    for p in range(_POWERS):
        factor = 1.0
        for i in range(p, -1, -1):
            weight = _BINOMIAL[p, i] * factor
            for pair in range(high[p]):
                moments[p, pair] += weight * block[i, pair]
            factor *= distance


@numba.njit(fastmath=_SUMS, forceinline=True)
def _normal(moments, pairs, columns):  # type: ignore[no-untyped-def]
    """Upper half of the products of all columns, scaled to size 1, with a ridge, and their
    sizes.
    """
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


@numba.njit(fastmath=_SUMS, forceinline=True)
def _solved(products):  # type: ignore[no-untyped-def]
    """Return the coefficients of all columns in the last one, all of size 1, and its residual.

    Cholesky's factor R replaces the upper half of `products`, R^H R.
    """
    n = len(products) - 1
    for j in range(n + 1):
        for i in range(j):
            value = products[i, j]
            for k in range(i):
                value -= products[k, i].conjugate() * products[k, j]
            products[i, j] = value / products[i, i].real
        pivot = products[j, j].real
        for k in range(j):
            pivot -= products[k, j].real ** 2 + products[k, j].imag ** 2
        products[j, j] = np.sqrt(max(pivot, RIDGE if j < n else 0.0))
    found = np.empty(n, np.complex128)
    for c in range(n - 1, -1, -1):
        value = products[c, n]
        for d in range(c + 1, n):
            value -= products[c, d] * found[d]
        found[c] = value / products[c, c].real
    ridge = RIDGE * (found.real**2 + found.imag**2).sum()
    return found, products[n, n].real ** 2 - ridge


@numba.njit(fastmath=_SUMS, forceinline=True)
def _left(rows, columns, found, place, count, half):  # type: ignore[no-untyped-def]
    """Return the sum of squares of the residual force over its bins; r = 0 at bin `place`."""
    total = 0.0
    for i in range(count):
        away = (i - place) / half
        value = complex(rows[_FORCE, 0, i], rows[_FORCE, 1, i])
        for c in range(len(found)):
            sequence = columns[c, 0]
            column = complex(rows[sequence, 0, i], rows[sequence, 1, i])
            value -= found[c] * column * away ** columns[c, 1]
        total += value.real**2 + value.imag**2
    return total


@numba.njit(fastmath=_SUMS, forceinline=True)
def _power(polynomial, moments):  # type: ignore[no-untyped-def]
    """Sum of the squares of J."""
    total = 0.0
    for a in range(TERMS):
        for b in range(TERMS):
            both = polynomial[a].conjugate() * polynomial[b]
            total += both.real * moments[a + b, _ONES].real
    return total
