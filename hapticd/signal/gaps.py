"""To the sample: where a file lost some, between stretches of which it is known how far they are
moved.

A stretch of the file is moved by k samples; where some were lost k falls by as many (`alignment`).
Between two stretches, and for any k between theirs that 256 samples show, each k ends at the sample
at which the squares of what does not fit, with the k before it and the k after it, are least: of
all of them together, by dynamic programming. A stretch of fewer than 64 samples is chance, and left
out. Gaps 200 samples apart are told apart; below 120 they are taken for one.

What would break it: noise beyond the size of the signal; the sample is then known to some dozens.
"""

from dataclasses import dataclass

import numpy as np

from hapticd.core.arrays import Flags, Floats, Integers
from hapticd.signal.matching import coefficients, interpolated

__all__ = ["Gap"]

INNER = 256  # samples, of a stretch that shows a k between two others
SHORTEST = 64  # samples for which a k holds
LEAST_INNER = 0.4  # coefficient of such a stretch; chance reaches 0.25


@dataclass(frozen=True, slots=True)
class Gap:
    """Samples that the file lost, or has too many of."""

    own_sample: int  # first sample of the own record after the last good row
    lost: int  # samples; negative: rows that stand twice or belong nowhere
    row: int  # of the file, the first after it


def find_gaps(
    part: Floats, first: int, other: Floats, rows: Floats, levels: list[int]
) -> list[Gap]:
    """The gaps between several k (`levels`, in their order) in own samples `part` (n,), from the
    own sample `first` on. Their rows in `other` (m,) would be `rows` (n,) for k = 0.
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
    """`levels` with those between them that a stretch shorter than a piece has: two gaps close to
    each other. `part` (n,): own samples, `rows` (n,): where they are for k = 0.
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
    """Squares (levels, n) of what of `part` (n,) does not fit what is heard (levels, n)."""
    power = float(part @ part)
    gain = float((heard @ part).max()) / power if power > 0.0 else 1.0
    return np.asarray((gain * part - heard) ** 2)


def _long(wrong: Floats, levels: list[int]) -> Flags:
    """Which of several k, (levels,), hold for long enough to be one: chance brings in others. The
    first and the last do.
    """
    lost = np.maximum(-np.diff(levels), 0)
    ends = np.array(_ends(wrong, lost))
    holds = np.ones(len(levels), dtype=bool)
    holds[1:-1] = np.diff(ends) - lost[:-1] >= SHORTEST
    return holds


def _ends(wrong: Floats, skipped: Integers) -> list[int]:
    """Where each of several k (but the last) ends, so that the squares that do not fit are least.

    `wrong` (levels, n): squares by each k. `skipped` (levels - 1,): samples lost after each.
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
