"""Telemetry blocks as payloads: the two forms of tick records.

`servo` is for viewers: an array of maps of plain numbers, one per tick, each with its own `timestamp`; a number that is not
finite is left out of its map. `servo.raw` is for acquisition: one map with a header and, in `d`, the records byte by byte as
the servo wrote them; numpy.frombuffer(d, numpy.dtype(descr)) is lossless and copies nothing.
"""

import math
from typing import Any

import msgpack
import numpy as np

from hapticd.gateway.feed import Block
from hapticd.mailbox.layout import LAYOUT_HASH, TELEMETRY
from hapticd.units import NS_PER_S

VERSION = 1
_LEFT_OUT = frozenset({"time_ns", "in_frame", "out_frame", "tail", "energy_j"})
COLUMNS: tuple[str, ...] = tuple(str(field[0]) for field in TELEMETRY if field[0] not in _LEFT_OUT)
ENERGIES = tuple(f"energy_{name}_j" for name in ("stiffness", "damping", "mass", "field", "force", "electrical"))
DESCR = [list(field) for field in TELEMETRY]


class Origin:
    """What the header of every block says about where it comes from: one per servo life."""

    def __init__(self, epoch: int, unix_offset_ns: int, simulated: bool) -> None:
        self.epoch, self.unix_offset_ns = epoch, unix_offset_ns
        self.header: dict[str, Any] = {
            "v": VERSION,
            "epoch": epoch,
            "mono_unix_offset_ns": unix_offset_ns,
            "simulated": simulated,
            "layout": LAYOUT_HASH.hex(),
        }


def servo_messages(block: Block, origin: Origin, batch: int, decimation: int) -> list[bytes]:
    """Payloads of topic `servo`: every `decimation`-th tick, at most `batch` of them in one."""
    wanted = np.flatnonzero((block.seq + np.arange(len(block.records))) % decimation == 0)
    records = block.records[wanted]
    columns: list[Any] = [
        ((records["time_ns"] + origin.unix_offset_ns) / NS_PER_S).tolist(),
        (block.seq + wanted).tolist(),
        *(records[name].tolist() for name in COLUMNS),
        *records["energy_j"].T.tolist(),
    ]
    names = ("timestamp", "seq", *COLUMNS, *ENERGIES)
    maps = [_finite(dict(zip(names, values, strict=True))) for values in zip(*columns, strict=True)]
    return [bytes(msgpack.packb(maps[start : start + batch])) for start in range(0, len(maps), batch)]


def _finite(numbers: dict[str, Any]) -> dict[str, Any]:
    # a sum is finite unless one of its terms is not (or it overflows, and then the slow way finds nothing)
    if math.isfinite(sum(numbers.values())):
        return numbers
    return {name: value for name, value in numbers.items() if math.isfinite(value)}


def raw_message(block: Block, origin: Origin) -> bytes:
    """Payload of topic `servo.raw`: {.., seq, next, n, lost, descr, d}."""
    return packed(origin, block.seq, block.seq + len(block.records), len(block.records), block.lost, DESCR, block.data)


def packed(origin: Origin, seq: int, after: int, count: int, lost: int, descr: list[Any], data: bytes, **more: Any) -> bytes:
    """Header and records: `seq` numbers the first one, `next` the one after the last; `lost` are missing since the last block."""
    place = {"seq": seq, "next": after, "n": count, "lost": lost, "descr": descr}
    return bytes(msgpack.packb(origin.header | place | more | {"d": data}))
