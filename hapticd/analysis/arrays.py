"""Names of the array types of `analysis`, and arrays that begin where vector registers like it."""

from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Flags = npt.NDArray[np.bool_]
Integers = npt.NDArray[np.int64]
Values = npt.NDArray[np.floating[Any]]

CACHE_LINE = 64  # bytes; vector loads across its border cost double


def aligned(size: int, scalar: type[np.floating[Any]]) -> Values:
    """Zeros (size,) that begin on a cache line."""
    item = np.dtype(scalar).itemsize
    memory = np.zeros(size + CACHE_LINE // item, scalar)
    start = -memory.ctypes.data % CACHE_LINE // item
    return memory[start : start + size]
