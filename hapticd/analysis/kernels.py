"""The inner loops of spectral sums and of local polynomials, compiled where numba is installed, in
numpy otherwise.

Both sets take the same arguments and give the same numbers to rounding. Nothing else in `analysis`
needs a compiler.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from hapticd.analysis.arrays import Complexes, Floats, Integers
from hapticd.analysis.local_fits import Fit, Transforms, local_fits

_BLOCK = 16_384


@dataclass(frozen=True)
class Kernels:
    """What `fitted_line`, `take_line_out` and `accumulate` below and `local_fits` do."""

    fitted_line: Callable[[Floats], tuple[float, float]]
    take_line_out: Callable[[Floats, float, float, Floats], Any]
    accumulate: Callable[[Complexes, Complexes, Complexes], Any]
    local_fits: Callable[[Transforms, Integers, Fit], Any]
    compiled: bool


@cache
def kernels() -> Kernels:
    """The compiled kernels, or the numpy ones where there is no numba."""
    try:
        from hapticd.analysis import compiled, compiled_fits
    except ImportError:
        return PLAIN
    return Kernels(
        compiled.fitted_line,
        compiled.take_line_out,
        compiled.accumulate,
        compiled_fits.local_fits,
        compiled=True,
    )


def fitted_line(signal: Floats) -> tuple[float, float]:
    """Value at the first sample and slope per sample of the least-squares line through `signal`
    (N,), N >= 2.
    """
    n = signal.size
    middle = 0.5 * (n - 1)
    starts = range(0, n, _BLOCK)
    moment = sum(
        float(
            np.arange(start - middle, min(start + _BLOCK, n) - middle)
            @ signal[start : start + _BLOCK]
        )
        for start in starts
    )
    slope = moment / (n * (float(n) * n - 1.0) / 12.0)
    return float(signal.mean()) - slope * middle, slope


def take_line_out(signal: Floats, value: float, slope: float, out: Floats) -> None:
    """`out` = `signal` (n,) minus the line with `value` at the first sample and `slope` per
    sample.
    """
    np.subtract(signal, value + slope * np.arange(signal.size), out=out)


def accumulate(velocity: Complexes, force: Complexes, sums: Complexes) -> None:
    """Add conj(first) (first + second) of neighbouring sections to `sums` (4, M + 1).

    `velocity`, `force`: (sections, M + 1) spectra of sections padded to 2 M. Rows of `sums`:
    velocity, force, force after velocity, velocity after force. A delay by M samples is a factor
    (-1)^k on bin k.
    """
    sign = np.ones(velocity.shape[1])
    sign[1::2] = -1.0
    u = velocity[:-1].conj()
    y = force[:-1].conj()
    later_u = velocity[:-1] + sign * velocity[1:]
    later_y = force[:-1] + sign * force[1:]
    for row, (first, second) in enumerate(((u, later_u), (y, later_y), (u, later_y), (y, later_u))):
        sums[row] += np.einsum("ij,ij->j", first, second)


PLAIN = Kernels(fitted_line, take_line_out, accumulate, local_fits, compiled=False)
