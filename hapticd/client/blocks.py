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

    records: structured array (n,), read-only, of the dtype that the message announces (field names carry units);
    gap: records that were lost before it, on the way or in the gateway; restarted: the numbering began anew (another servo
    life, or another run of the board), then `gap` is 0; header: everything else in the message, such as `simulated`,
    `mono_unix_offset_ns` (add it to `time_ns` for Unix time) or, for the probe, `scale`.
    """

    records: Records
    gap: int
    restarted: bool
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
        self._origin, self._next = origin, header["next"]
        return Block(records, gap, restarted, header)
