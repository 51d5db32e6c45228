"""The loops of `kernels` in numba: one pass each, without temporaries. Imported only by `kernels`,
only if numba is there.

They release the interpreter lock, so trials may run on threads. Sums are reassociated for vector
registers: results agree with numpy's to rounding, not to the bit.
"""

import numba

_SUMS = {"contract", "reassoc", "nsz"}


@numba.njit(fastmath=_SUMS, nogil=True, cache=True)
def fitted_line(signal):  # type: ignore[no-untyped-def]
    """See `kernels.fitted_line`."""
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
    """See `kernels.take_line_out`."""
    for i in range(signal.size):
        out[i] = signal[i] - (value + slope * i)


@numba.njit(fastmath=_SUMS, nogil=True, cache=True)
def accumulate(velocity, force, sums):  # type: ignore[no-untyped-def]
    """See `kernels.accumulate`."""
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
