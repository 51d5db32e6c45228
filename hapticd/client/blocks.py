"""Telemetry messages as numpy arrays, with the number of lost records; waveforms as requests."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import msgpack
import numpy as np
from numpy.typing import ArrayLike

from hapticd.core.arrays import Floats, Records
from hapticd.core.errors import ConfigError
from hapticd.core.units import NS_PER_S

__all__ = ["Block", "BlockDecoder"]

# 32 kB as float32, half of what a message may hold
CHUNK_SAMPLES = 8192  # of a waveform, in one message
STREAMED = ("servo.raw", "probe")  # topics whose messages are blocks of records


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive records of topic `servo.raw` or `probe`.

    The dtype of `records` is announced in the message; its field names contain the units.
    """

    records: Records  #: structured array (n,), read-only
    gap: int  #: records lost before it, in transit or in the gateway; 0 if restarted
    restarted: bool  #: the numbering restarted: another servo life, or another run of the board
    #: everything else in the message, such as `simulated`, `mono_unix_offset_ns` (add it to
    #: `time_ns` for Unix time) or, for the probe, `scale`
    header: dict[str, Any]

    def signals(self) -> Floats:
        """Return force [N] and velocity [m/s] (2, n) of the probe. KeyError for another topic."""
        scales = {name: self.header["scale"][name] for name in ("torque", "velocity")}
        return np.stack(
            [
                one["sign"]
                * (self.records[name].astype(np.float64) - one["offset_count"])
                * one["per_count"]
                for name, one in scales.items()
            ]
        )


@lru_cache(maxsize=8)
def _dtype(descr: tuple[Any, ...]) -> np.dtype[Any]:
    return np.dtype(list(descr))


class BlockDecoder:
    """Decodes the messages of one subscription and counts missing records."""

    def __init__(self) -> None:
        self._next: int | None = None
        self._origin: tuple[Any, Any] | None = None

    def decode(self, payload: bytes) -> Block:
        """Return the block in `payload`. ValueError or KeyError if it is not one."""
        header = msgpack.unpackb(payload, use_list=False)
        records = np.frombuffer(header.pop("d"), _dtype(header.pop("descr")))
        origin = header["epoch"], header.get("run")
        restarted = self._origin is not None and origin != self._origin
        first = self._next is None or restarted
        gap = 0 if first else header["next"] - self._next - len(records)
        self._origin = origin
        self._next = header["next"]
        return Block(records, gap, restarted, header)


class Excerpt:
    """The first `seconds` of recorded time or `count` records of a topic, its last block cut to
    fit; without either, all records. ConfigError for a topic without blocks, or an empty request.
    """

    def __init__(self, topic: str, seconds: float | None, count: int | None) -> None:
        if topic not in STREAMED:
            known = f"stream takes {' or '.join(STREAMED)}, listen takes every topic"
            raise ConfigError(f"topic {topic!r} has no blocks: {known}")
        for name, value, unit, usual in (
            ("seconds", seconds, " s", 1.0),
            ("count", count, "", 100),
        ):
            if value is not None and not 0 < value < math.inf:
                raise ConfigError(
                    f"{name} = {value:g}{unit}: must be above 0 and finite; ask for more, such as"
                    f" {name}={usual}"
                )
        self._seconds = seconds
        self._count = count
        self._decoder = BlockDecoder()
        self._taken = 0
        self._end_ns: int | None = None
        self.complete = False

    def next(self, payload: bytes) -> Block:
        """Return the part of the message `payload` that belongs to it; it may have no records."""
        block = self._decoder.decode(payload)
        records = block.records
        if self._seconds is not None and len(records):
            first_ns = int(records["time_ns"][0])
            self._end_ns = self._end_ns or first_ns + round(self._seconds * NS_PER_S)
            records = records[records["time_ns"] < self._end_ns]
        if self._count is not None:
            records = records[: self._count - self._taken]
        self._taken += len(records)
        self.complete = len(records) < len(block.records) or self._taken == self._count
        return Block(records, block.gap, block.restarted, block.header)


def concatenated(blocks: Sequence[Block]) -> tuple[Records, int]:
    """Return all records of `blocks` in one structured array (n,), and the number of
    missing ones.
    """
    return np.concatenate([block.records for block in blocks]), sum(block.gap for block in blocks)


def chunks(samples_n: ArrayLike) -> Iterator[dict[str, Any]]:
    """Yield the fields of the requests that load a waveform: force [N] at 4 kHz, shape (n,)."""
    samples = np.asarray(samples_n, "<f4").ravel()
    for start in range(0, max(len(samples), 1), CHUNK_SAMPLES):
        chunk = samples[start : start + CHUNK_SAMPLES].tobytes()
        yield {"action": "load", "samples_n": chunk, "offset": start}
