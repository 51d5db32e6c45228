"""Telemetry messages as numpy arrays, with what was lost between them."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

Records = NDArray[np.void]


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive records of topic `servo.raw` or `probe`.

    The dtype of `records` is that which the message announces; its field names carry units.
    """

    records: Records  # structured array (n,), read-only
    gap: int  # records that were lost before it, on the way or in the gateway; 0 if restarted
    restarted: bool  # the numbering began anew: another servo life, or another run of the board
    # everything else in the message, such as `simulated`, `mono_unix_offset_ns` (add it to
    # `time_ns` for Unix time) or, for the probe, `scale`
    header: dict[str, Any]


@lru_cache(maxsize=8)
def _dtype(descr: tuple[Any, ...]) -> np.dtype[Any]:
    return np.dtype(list(descr))


class BlockDecoder:
    """Decodes the messages of one subscription and counts what is missing."""

    def __init__(self) -> None:
        self._next: int | None = None
        self._origin: tuple[Any, Any] | None = None

    def decode(self, payload: bytes) -> Block:
        """The block in `payload`. ValueError or KeyError if it is none."""
        header = msgpack.unpackb(payload, use_list=False)
        records = np.frombuffer(header.pop("d"), _dtype(header.pop("descr")))
        origin = header["epoch"], header.get("run")
        restarted = self._origin is not None and origin != self._origin
        first = self._next is None or restarted
        gap = 0 if first else header["next"] - self._next - len(records)
        self._origin = origin
        self._next = header["next"]
        return Block(records, gap, restarted, header)
