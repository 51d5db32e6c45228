"""One signal in another: its position, its delay by a fraction of a sample, and the parts that fit.

The fraction is where the correlation between the samples, the real part of sum R(w) F*(w) e^(-jwt),
has its peak; Newton's method finds it (Knapp and Carter 1976, "The generalized correlation method
for estimation of time delay", IEEE ASSP-24).

Limitations: a signal of one frequency, which matches itself a period later.

Gaps to the sample. A stretch of the file is shifted by k samples. A loss of samples lowers k by
their number (`alignment`). The levels considered are those of the two known stretches, and any k
between them that 256 samples show. Each k ends at the sample that minimises the squares of the
misfit before and after it, for all of them together, by dynamic programming. A stretch of fewer
than 64 samples is chance and is dropped. Gaps 200 samples apart are resolved; below 120 they merge
into one.

Limitations: noise stronger than the signal; the sample is then known only to a few dozen.
"""

from dataclasses import dataclass

import numpy as np

from hapticd.core.arrays import Flags, Floats, Integers

__all__ = ["Gap", "fitting", "interpolated"]

FLAT = 1e-6  # of the mean variance: below it the stretch has no signal
TAPS = 16  # on either side, of the interpolation between samples
CHUNK = 1 << 15  # samples interpolated at once
NEWTON = 5  # rounds
BLOCK = 128  # samples per comparison
LEAST_BLOCK = 0.25  # share of a block that must be known
USUAL = 0.5  # of the usual coefficient: a block that fits less does not fit
_TINY = float(np.finfo(np.float64).tiny)


def coefficients(pattern: Floats, signal: Floats) -> Floats:
    """Return the correlation coefficient of `pattern` (p,) with `signal` (n,) from every row on, (n
    - p + 1,); 0 where the signal is constant.
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
    """Return by how many samples `other` (n,) lags `own` (n,), within -1 to 1."""
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
    """Interpolate `values` (n,) at the positions `at` (m,) with a sinc under a raised cosine of 16
    samples on either side.
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
    """Return which samples of `other` (n,), of those `known`, are in a block that fits `own_n` (n,)
    [N] at least half as well as the usual block.
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


# --- gaps of a file -------------------------------------------------------------------------------


INNER = 256  # samples of a stretch that can show a k between two others
SHORTEST = 64  # minimum samples for which a k holds
LEAST_INNER = 0.4  # coefficient of such a stretch; chance reaches 0.25


@dataclass(frozen=True, slots=True)
class Gap:
    """Samples that the file lost, or duplicated."""

    own_sample: int  # first sample of the own record after the last good row
    lost: int  # samples; negative: duplicated or foreign rows
    row: int  # of the file, the first after it


def find_gaps(
    part: Floats, first: int, other: Floats, rows: Floats, levels: list[int]
) -> list[Gap]:
    """Return the gaps between several k (`levels`, in order) in own samples `part` (n,), from the
    own sample `first` on. For k = 0 they are in `rows` (n,) of `other` (m,).
    """
    levels = _with_inner(part, other, rows, levels)
    wrong = _wrong(part, np.stack([interpolated(other, rows + level) for level in levels]))
    long = _long(wrong, levels)
    levels = [level for level, keep in zip(levels, long, strict=True) if keep]
    lost = -np.diff(levels)
    found = []
    for number, end in enumerate(_ends(wrong[long], np.maximum(lost, 0))):
        row = round(float(rows[max(0, end - 1)]) + levels[number]) + 1
        found.append(Gap(first + end, int(lost[number]), row))
    return found


def _with_inner(part: Floats, other: Floats, rows: Floats, levels: list[int]) -> list[int]:
    """Add to `levels` those between them that a stretch shorter than a piece has: two gaps close to
    each other. `part` (n,): own samples, `rows` (n,): their rows for k = 0.
    """
    seen = set()
    for first in range(0, part.size - INNER + 1, INNER // 2):
        row = round(float(rows[first]))
        lowest = max(0, row + min(levels))
        found = coefficients(part[first : first + INNER], other[lowest : row + max(levels) + INNER])
        if found.size and found.max() >= LEAST_INNER:
            seen.add(lowest + int(np.argmax(found)) - row)
    whole = levels[:1]
    for level in levels[1:]:
        low, high = sorted((whole[-1], level))
        whole += sorted((k for k in seen if low < k < high), reverse=whole[-1] > level)
        whole.append(level)
    return whole


def _wrong(part: Floats, heard: Floats) -> Floats:
    """Return the squares (levels, n) of the misfit of `part` (n,) to `heard` (levels, n)."""
    power = float(part @ part)
    gain = float((heard @ part).max()) / power if power > 0.0 else 1.0
    return np.asarray((gain * part - heard) ** 2)


def _long(wrong: Floats, levels: list[int]) -> Flags:
    """Return which of several k, (levels,), hold for long enough not to be chance; always the first
    and the last.
    """
    lost = np.maximum(-np.diff(levels), 0)
    ends = np.array(_ends(wrong, lost))
    holds = np.ones(len(levels), dtype=bool)
    holds[1:-1] = np.diff(ends) - lost[:-1] >= SHORTEST
    return holds


def _ends(wrong: Floats, skipped: Integers) -> list[int]:
    """Return where each of several k (but the last) ends, so that the squares of the misfit are
    minimal.

    `wrong` (levels, n): squares for each k. `skipped` (levels - 1,): samples lost after each.
    """
    sums = np.cumsum(np.pad(wrong, ((0, 0), (1, 0))), axis=1)
    count = sums.shape[1]
    best = sums[0]
    ways = []
    for total, lost in zip(sums[1:], skipped.tolist(), strict=True):
        entered = np.full(count, np.inf)
        entered[lost:] = best[: count - lost] - total[lost:]
        least = np.minimum.accumulate(entered)
        ways.append(np.maximum.accumulate(np.where(entered <= least, np.arange(count), 0)) - lost)
        best = total + least
    ends = [count - 1]
    for way in reversed(ways):
        ends.append(int(way[ends[-1]]))
    return ends[:0:-1]
