"""Array types, and arrays aligned for vector loads.

All numbers are in SI and double precision; only sums over many trials at once may be float32
(`Values`). A vector load across the border of two cache lines costs twice as much. The vectors of
`batch_fft` may only be loaded from such a border; `aligned` creates arrays for them.
`lazy_property` caches results that are used repeatedly.
"""

from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

__all__ = [
    "CACHE_LINE",
    "Complexes",
    "Flags",
    "Floats",
    "Integers",
    "Records",
    "Values",
    "aligned",
    "alternating",
    "bisect",
    "lazy_property",
]

Floats = npt.NDArray[np.float64]  # SI values
Complexes = npt.NDArray[np.complex128]  # responses, transforms, impedances
Flags = npt.NDArray[np.bool_]  # one truth value for each item
Integers = npt.NDArray[np.int64]  # indices of another array
Records = npt.NDArray[np.void]  # rows of named fields
Values = npt.NDArray[np.floating[Any]]  # float32 or float64, as the batch has them

CACHE_LINE = 64  # bytes; vector loads across its border cost twice as much

T = TypeVar("T")


class lazy_property(Generic[T]):
    """A property that is computed on first access and cached in its object.

    As `functools.cached_property`, which in Python 3.11 holds a lock for all objects and threads
    while it computes. Here two threads may compute the same value, with the same bits.
    """

    def __init__(self, compute: Callable[[Any], T]) -> None:
        self._compute = compute
        self._name = compute.__name__
        self.__doc__ = compute.__doc__

    def __get__(self, owner: Any, kind: type) -> T:
        """Return the value and store it in `owner` under the same name, which bypasses this method
        later.
        """
        found = self._compute(owner)
        owner.__dict__[self._name] = found
        return found


def bisect(holds: Callable[[Any], Any], low: Any, high: Any, times: int) -> tuple[Any, Any]:
    """Halve intervals `times` times around the edge between `low`, where `holds` is true, and
    `high`, where it is false.

    The ends are numbers, or arrays (n,), of which `holds` gets a value inside each interval.
    """
    for _ in range(times):
        half = 0.5 * (low + high)
        inside = holds(half)
        low = np.where(inside, half, low)
        high = np.where(inside, high, half)
    return low, high


def alternating(count: int) -> Floats:
    """Return 1, -1, 1 .. (count,): a delay by a section of M samples, on the bins of 2 M points."""
    signs = np.ones(count)
    signs[1::2] = -1.0
    return signs


def aligned(size: int, scalar: type[np.floating[Any]]) -> Values:
    """Return zeros (size,) of type `scalar` that begin on a cache line."""
    item = np.dtype(scalar).itemsize
    memory = np.zeros(size + CACHE_LINE // item, scalar)
    start = -memory.ctypes.data % CACHE_LINE // item
    return memory[start : start + size]
