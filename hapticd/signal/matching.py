"""One signal in another: where it is, by what fraction of a sample it comes later, and which parts
of it fit.

The fraction is where the correlation between the samples, the real part of sum R(w) F*(w) e^(-jwt),
has its peak: bent as it is there, Newton's way leads to it (Knapp and Carter 1976, "The generalized
correlation method for estimation of time delay", IEEE ASSP-24).

What would break it: a signal of one frequency, which fits itself a period later just as well.
"""

import numpy as np

from hapticd.core.arrays import Flags, Floats

__all__ = ["fitting", "interpolated"]

FLAT = 1e-6  # of the mean variance: less is a stretch in which nothing was measured
TAPS = 16  # on either side, of the interpolation between samples
CHUNK = 1 << 15  # samples interpolated at once
NEWTON = 5  # rounds
BLOCK = 128  # samples that are compared
LEAST_BLOCK = 0.25  # of a block has to be known to be compared
USUAL = 0.5  # of the usual coefficient: a block that fits less does not fit
_TINY = float(np.finfo(np.float64).tiny)


def coefficients(pattern: Floats, signal: Floats) -> Floats:
    """Correlation coefficient of `pattern` (p,) with `signal` (n,) from every row on, (n - p + 1,);
    0 where the signal stands still.
    """
    size = pattern.size
    count = signal.size - size + 1
    if count < 1:
        return np.empty(0)
    shape = pattern - pattern.mean()
    signal = signal - signal.mean()
    points = 1 << (signal.size + size - 1).bit_length()
    spectrum = np.fft.rfft(signal, points) * np.conj(np.fft.rfft(shape, points))
    product = np.fft.irfft(spectrum, points)[:count]
    sums = np.cumsum(np.concatenate(([0.0], signal)))
    squares = np.cumsum(np.concatenate(([0.0], signal**2)))
    power = squares[size:] - squares[:-size] - (sums[size:] - sums[:-size]) ** 2 / size
    least = FLAT * max(float(power.mean()), _TINY)
    scale = np.sqrt(np.maximum(power, least) * float(shape @ shape))
    return np.where(power > least, product / scale, 0.0)


def fraction(own: Floats, other: Floats) -> float:
    """By how many samples `other` (n,) comes later than `own` (n,), within -1 to 1."""
    window = np.hanning(own.size)
    cross = np.fft.rfft(window * own) * np.conj(np.fft.rfft(window * other))
    omega = 2.0 * np.pi * np.fft.rfftfreq(own.size)
    late = 0.0
    for _ in range(NEWTON):
        turned = cross * np.exp(-1j * omega * late)
        bent = float((omega**2 * turned.real).sum())
        if bent <= 0.0:
            break
        late = float(np.clip(late + (omega * turned.imag).sum() / bent, -1.0, 1.0))
    return late


def interpolated(values: Floats, at: Floats) -> Floats:
    """`values` (n,) between their samples, at the places `at` (m,): a sinc under a raised cosine
    of 16 samples on either side.
    """
    taps = np.arange(1 - TAPS, TAPS + 1)
    found = np.empty(at.size)
    for first in range(0, at.size, CHUNK):
        part = at[first : first + CHUNK]
        whole = np.floor(part).astype(np.int64)
        away = (part - whole)[:, None] - taps
        weight = np.sinc(away) * (0.5 + 0.5 * np.cos(np.pi * away / TAPS))
        weight /= weight.sum(axis=1, keepdims=True)
        near = np.clip(whole[:, None] + taps, 0, values.size - 1)
        found[first : first + CHUNK] = (weight * values[near]).sum(axis=1)
    return found


def fitting(own_n: Floats, other: Floats, known: Flags) -> Flags:
    """Which samples of `other` (n,), of those `known`, lie in a block that fits `own_n` (n,) [N] at
    least half as well as the usual one.
    """
    count = -(-own_n.size // BLOCK)
    padded = np.zeros((3, count * BLOCK))
    padded[:, : own_n.size] = known * np.stack((own_n, other, np.ones(own_n.size)))
    own, heard, used = padded.reshape(3, count, BLOCK)
    number = np.maximum(used.sum(axis=1, keepdims=True), 1.0)
    own = own - used * own.sum(axis=1, keepdims=True) / number
    heard = heard - used * heard.sum(axis=1, keepdims=True) / number
    power = (own**2).sum(axis=1) * (heard**2).sum(axis=1)
    coefficient = np.abs((own * heard).sum(axis=1)) / np.sqrt(np.maximum(power, _TINY))
    enough = number[:, 0] >= LEAST_BLOCK * BLOCK
    usual = float(np.median(coefficient[enough])) if enough.any() else 0.0
    fits = ~enough | (coefficient >= USUAL * usual)
    return np.asarray(known & np.repeat(fits, BLOCK)[: own_n.size])
