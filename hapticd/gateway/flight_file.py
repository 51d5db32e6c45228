"""A flight recording: one file that holds records and all that flying them again needs. Written whole or not at all.

    hapticd-flight/1 LF | length of the header, u64 little-endian | header, JSON | records, `descr` of the header

header: reason, written_utc, version, simulated, rate_hz, epoch, mono_unix_offset_ns, descr, servo (params.ServoParams), report
(rights granted, board), gaps [[row, lost]], checkpoints [[tick, state]], requests [[tick, seq, kind, actor, apply_tick,
values]], breaks [tick]: requests were lost there, so no flight leads over it.
"""

import json
import os
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hapticd.errors import ConfigError
from hapticd.gateway.records import Records

SUFFIX = ".flight"
_MAGIC, _LENGTH = b"hapticd-flight/1\n", struct.Struct("<Q")


class Flight(NamedTuple):
    """What is in such a file."""

    header: dict[str, Any]
    records: Records


def write(path: Path, header: dict[str, Any], blocks: Iterable[bytes]) -> None:
    """Write `header` and the records in `blocks` to `path`, whose folder is made. OSError: no room, no right."""
    path.parent.mkdir(mode=0o750, parents=True, exist_ok=True)
    text = json.dumps(header).encode()
    fresh = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with fresh.open("wb") as file:
            file.write(_MAGIC + _LENGTH.pack(len(text)) + text)
            file.writelines(blocks)
        fresh.replace(path)
    finally:
        fresh.unlink(missing_ok=True)


def read(path: Path) -> Flight:
    """The flight in `path`. ConfigError if it is none, or cut short."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; check the path") from error
    begin = len(_MAGIC) + _LENGTH.size
    if len(data) < begin or not data.startswith(_MAGIC):
        raise ConfigError(f"{path} is no flight recording; they are made by `hapticd dump` and at faults")
    (length,) = _LENGTH.unpack_from(data, len(_MAGIC))
    try:
        header = json.loads(data[begin : begin + length])
        dtype = np.dtype([(name, kind, *map(tuple, shape)) for name, kind, *shape in header["descr"]])
        return Flight(header, np.frombuffer(data, dtype, offset=begin + length))
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path} is damaged: {error}") from error
