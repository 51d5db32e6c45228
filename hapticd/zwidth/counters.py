"""Numbers that another acquisition system gives its rows: a counter of samples, or a clock of 48
bits.

A counter grows by 1 with every sample, so a larger step is a loss. Both begin anew at 2^48 at the
latest: a step back of about that much is a step forward.

What would break it: a counter of fewer bits that begins anew within the record; it is refused.
"""

import numpy as np

from hapticd.core.arrays import Floats, Integers
from hapticd.core.errors import AnalysisError

BITS = 48  # of the longest counter
WRAP = 1 << BITS
MOST_LOST_AT_ONCE = 1 << 24  # samples, an hour
REMEDY = "name the right column with --counter, or leave that out"


def counted(name: str, counts: Floats) -> tuple[Integers, int]:
    """Places (n,) from 0 by the counter of samples `name`, and its first number. AnalysisError
    for numbers that do not count samples.
    """
    _whole(name, counts)
    steps = np.mod(np.diff(counts.astype(np.int64)), WRAP)
    if steps.size and not _counts_samples(steps):
        raise AnalysisError(
            f"column {name} counts by {steps.min()} to {steps.max()}, median"
            f" {np.median(steps):g}; a number that grows by 1 with every sample was expected:"
            f" {REMEDY}"
        )
    return np.concatenate(([0], np.cumsum(steps))), int(counts[0])


def _whole(name: str, counts: Floats) -> None:
    """AnalysisError for what is no whole number of BITS bits."""
    good = (counts >= 0.0) & (counts < WRAP) & (counts == np.rint(counts))
    if not good.all():
        row = int(np.argmin(good))
        raise AnalysisError(
            f"column {name}: {counts[row]:.9g} at sample {row + 1}; a whole number from 0 to"
            f" 2^{BITS} - 1 was expected: {REMEDY}"
        )


def _counts_samples(steps: Integers) -> bool:
    """Whether `steps` of a counter are of 1, but for what a record can have lost."""
    least, most = int(steps.min()), int(steps.max())
    return least >= 1 and most <= MOST_LOST_AT_ONCE and float(np.median(steps)) == 1.0


def unwrapped(times: Floats) -> Floats:
    """`times` (n,) of a clock, in its own unit, as if it had not begun anew at 2^48; any other
    fall stays as it is.
    """
    back = np.flatnonzero(np.diff(times) < 0.0)
    if back.size != 1 or times[back[0] + 1] - times[back[0]] > -WRAP / 2:
        return times
    return np.where(np.arange(times.size) > back[0], times + WRAP, times)
