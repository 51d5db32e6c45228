"""A perturbation as another acquisition system would record it, with a separate clock.

The signal between its samples is that of its Fourier series, 16 times as dense, and linear in
between. It shares no code with the interpolation of the package.
"""

import numpy as np

from hapticd.model.excitation import MARK_LEAD, marked, torque_record
from hapticd.model.scene import Excitation

DENSE = 16
SETTLE = 4000  # samples before the record begins
MARK_AT = MARK_LEAD - SETTLE  # in samples of the record
BEFORE = 3000  # samples of silence before the perturbation


def played(seconds: float, seed: int = 1) -> np.ndarray:
    """Return the force of the probe motor [N]: silence, a marked perturbation, silence."""
    noise = Excitation("noise", psd_n2_per_hz=2.5e-5, band_hz=1700.0)
    force = marked(torque_record(noise, SETTLE + round(4000 * seconds), seed))
    return np.concatenate((np.zeros(BEFORE), force, np.zeros(BEFORE)))


def own(force: np.ndarray) -> np.ndarray:
    """The part of it that is the daemon's record."""
    return force[BEFORE + SETTLE : -BEFORE]


def recorded(force: np.ndarray, offset: float, ppm: float, rows: int) -> np.ndarray:
    """`rows` samples of `force` by a clock that is fast by `ppm`; the record's sample 0 is its row
    `offset`.
    """
    spectrum = np.fft.rfft(force)
    dense = np.fft.irfft(spectrum, DENSE * force.size) * DENSE
    at = BEFORE + SETTLE + (np.arange(rows) - offset) / (1.0 + 1e-6 * ppm)
    return np.interp(DENSE * at, np.arange(dense.size), dense, left=0.0, right=0.0)


def without(values: np.ndarray, gaps: tuple[tuple[int, int], ...]) -> np.ndarray:
    """`values` without `lost` rows from each row on, (row, lost)."""
    keep = np.ones(len(values), dtype=bool)
    for row, lost in gaps:
        keep[row : row + lost] = False
    return values[keep]
