"""Telemetry records as numpy sees them; the dtype is made from the one table in mailbox.layout."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapticd.mailbox import layout

Records = NDArray[np.void]

DTYPE = np.dtype(list(layout.TELEMETRY))
FIELDS: tuple[str, ...] = tuple(str(field[0]) for field in layout.TELEMETRY)
assert DTYPE.itemsize == layout.RECORD.size


def as_records(data: bytes) -> Records:
    """Whole records in `data` as a structured array (n,) of DTYPE that shares its memory."""
    return np.frombuffer(data, DTYPE)


def rows(data: bytes) -> list[dict[str, Any]]:
    """Whole records in `data` as maps of plain Python values."""
    return [dict(zip(FIELDS, values, strict=True)) for values in as_records(data).tolist()]


def last_torn(records: Records) -> int:
    """Number of leading records up to the last one whose end is not of the same tick as its beginning; 0 if all are whole."""
    torn = np.flatnonzero(records["tick"] != records["tail"])
    return int(torn[-1]) + 1 if torn.size else 0
