"""Strip charts in braille: 2 x 4 dots in a character; every dot column spans the lowest and highest value of its time."""

import numpy as np
from numpy.typing import ArrayLike

_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
_BLANK = 0x2800


def envelope(values: ArrayLike, length: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest of `values`, shape (n,), in each of `columns` equal parts of `length` samples, newest right.

    Shape (columns,) each; NaN where there is no sample yet.
    """
    padded = np.full(columns * max(1, -(-length // columns)), np.nan)
    newest = np.asarray(values, float)[-len(padded) :]
    padded[len(padded) - len(newest) :] = newest
    parts = padded.reshape(columns, -1)
    empty = np.isnan(parts)
    lows = np.where(empty, np.inf, parts).min(axis=1)
    highs = np.where(empty, -np.inf, parts).max(axis=1)
    known = ~empty.all(axis=1)
    return np.where(known, lows, np.nan), np.where(known, highs, np.nan)


def strip(values: ArrayLike, length: int, width: int, height: int, low: float, high: float) -> list[str]:
    """`height` lines of `width` characters: the last `length` of `values`, shape (n,), between `low` and `high`."""
    lows, highs = envelope(values, length, 2 * width)
    rows = 4 * height
    known = ~np.isnan(lows)
    scale = (rows - 1) / (high - low) if high > low else 0.0
    bottom, top = (np.clip(np.round((np.where(known, edge, low) - low) * scale), 0, rows - 1) for edge in (lows, highs))
    level = np.arange(rows)[::-1, None]
    dots = (level >= bottom) & (level <= top) & known
    cells = dots.reshape(height, 4, width, 2) * _BITS[None, :, None, :]
    return ["".join(map(chr, line)) for line in _BLANK + cells.sum(axis=(1, 3))]
