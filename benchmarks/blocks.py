"""Statistics of blocks: a quantile of each block, then the median over the blocks, so that one
disturbed block is one vote.
"""

from collections.abc import Sequence
from statistics import median


def quantile(values: Sequence[float], fraction: float) -> float:
    """Return the value below which `fraction` of `values` lie (nearest rank)."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(fraction * len(ordered)))]


def median_quantile(blocks: Sequence[Sequence[float]], fraction: float) -> float:
    """Return the median over `blocks` of their quantile."""
    return median(quantile(block, fraction) for block in blocks)
