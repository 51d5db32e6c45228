"""The energy ledger of a recording: for every tick the sums by cause since its first record.

A finished file contains them in its group `energy`. For any other file they are computed here, from
the records, with the gateway's own ledger. Across a gap, and from one servo life to the next, no
motion is booked. Recordings of boards that did not report the force in effect are booked with the
delay assumed at the time, so nothing in them is unexplained.

Limitations: records without a field that the ledger reads (`Recording.records` raises the error).
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hapticd.protocol.view import NAMES, Ledger
from hapticd.recording.file import Recording

__all__ = ["total_j"]

GROUP = "energy"
DATASETS = tuple(f"{name}_j" for name in NAMES)
ROWS_AT_ONCE = 1 << 15


def energies(recording: Recording) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Yield first row, and sums [J] after each row from it on, (n, causes) in the order of
    DATASETS. ConfigError if another version recorded it, and a field is missing.
    """
    ledger = Ledger(recording.params)
    for first, after, _ in recording.stretches():
        ledger.forget()
        for begin in range(first, after, ROWS_AT_ONCE):
            yield begin, ledger.take(recording.records(begin, min(begin + ROWS_AT_ONCE, after)))


def total_j(recording: Recording) -> dict[str, float]:
    """Return the energy [J] by cause of the whole recording. ConfigError as `energies`."""
    last = np.zeros(len(NAMES))
    if rows := recording.rows.get(GROUP, 0):
        last = np.array([recording.column(GROUP, name, rows - 1, rows)[0] for name in DATASETS])
    else:
        for _, sums in energies(recording):
            last = sums[-1]
    return dict(zip(NAMES, last.tolist(), strict=True))
