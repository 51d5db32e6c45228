"""Ticks of a running servo while a step measures, and the file in which they are kept.

`collect` receives the topic `servo.raw` for some time. `keep` writes arrays beside the device file,
as rig/NAME-DATE-STEP.npz, and says the SHA-256 of what it wrote: the device file names both.

What would break it: a daemon that restarts in between (DaemonDown says so).
"""

import datetime
import hashlib
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.client.blocks import BlockDecoder, Records
from hapticd.client.client import Client
from hapticd.core.arrays import Floats
from hapticd.core.errors import DaemonDown
from hapticd.core.params import ScaleParams
from hapticd.usb import codec

__all__ = ["collect", "identity_of", "keep"]

TICKS = "servo.raw"
SILENT_LOOKS = 40  # without a message: 2 s
DIGITS = 12  # of the hash in the device file


class Stretch(NamedTuple):
    """Consecutive ticks."""

    records: Records  # structured (n,), of layout.TELEMETRY
    lost: int  # that telemetry left out
    newest_tick: int  # that had come; the records may end sooner


class BoardIdentity(NamedTuple):
    """Which board it is, in which of its lives."""

    serial: str  # as its hello says
    firmware: str  # as its hello says, like 1.0
    life: int | None  # changes whenever it starts; None: no frame of it came


class Kept(NamedTuple):
    """A file of raw records."""

    path: Path
    sha256: str  # hex


def servo_rate_hz(bench: Client) -> float:
    """The rate at which the servo of `bench` ticks."""
    return float(bench.hello().servo["realtime"]["rate_hz"])


def collect(bench: Client, seconds: float, begin: Callable[[], object] | None = None) -> Stretch:
    """The ticks of the next `seconds`, counted from what `begin` does as soon as ticks come.
    DaemonDown if none come for 2 s, or the servo restarts.
    """
    decoder = BlockDecoder()
    parts: list[Records] = []
    lost = 0
    quiet = 0
    wanted = round(seconds * servo_rate_hz(bench))
    for message in bench.messages((TICKS,)):
        quiet = quiet + 1 if message is None else 0
        if quiet > SILENT_LOOKS:
            break
        if message is None:
            continue
        block = decoder.decode(message[1])
        if block.restarted:
            raise DaemonDown("the servo restarted meanwhile; see `hapticd status`, then repeat")
        if begin is not None:
            begin()
            begin = None
            continue
        lost += block.gap if parts else 0
        parts.append(block.records)
        if sum(map(len, parts)) + lost >= wanted:
            found = np.concatenate(parts)
            return Stretch(found[:wanted], lost, int(found["tick"][-1]))
    raise DaemonDown("no ticks came for 2 s; see `hapticd status`, then repeat")


def identity_of(bench: Client, records: Records) -> BoardIdentity:
    """The board of `bench`, which sent the frames of `records`."""
    said = bench.status().servo.get("board", {})
    came = records["in_frame"][records["arrival"] >= 0]
    life = codec.decode_in(bytes(came[-1])).life if len(came) else None
    return BoardIdentity(str(said.get("serial", "")), str(said.get("firmware", "")), life)


def counts_of(records: Records, position: Mapping[str, Any]) -> Floats:
    """Encoder counts (n,) since the origin, by the scale `position` of the hello."""
    scale = ScaleParams(**position)
    slope = scale.to_value(1.0) - scale.to_value(0.0)
    found: Floats = np.round(records["position_m"] / slope)
    return found


def raw_counts(values: Floats, scale: Mapping[str, Any]) -> Floats:
    """Counts (n,) of what was read as `values` (n,) by the hello's `scale`."""
    known = ScaleParams(**scale)
    found: Floats = known.sign * values / known.per_count + known.offset_count
    return found


def keep(
    device_file: Path, step: str, day: datetime.date, arrays: Mapping[str, npt.NDArray[Any]]
) -> Kept:
    """Write `arrays` beside `device_file`; an earlier file of that day stays."""
    folder = device_file.parent / "rig"
    folder.mkdir(exist_ok=True)
    stem = f"{device_file.stem}-{day.isoformat()}-{step}"
    names = (f"{stem}{f'-{number}' if number > 1 else ''}.npz" for number in range(1, 1000))
    path = next(folder / name for name in names if not (folder / name).exists())
    partial = path.with_suffix(".partial")
    with partial.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
    os.replace(partial, path)
    return Kept(path, hashlib.sha256(path.read_bytes()).hexdigest()[:DIGITS])
