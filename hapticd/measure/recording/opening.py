"""Opening what was recorded: finished files, live or crashed ones, flight recordings. All become a Recording."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from hapticd.errors import ConfigError
from hapticd.gateway import flight_file
from hapticd.measure.recording.channels import Columns, as_channel, columns
from hapticd.measure.recording.libraries import needed
from hapticd.measure.recording.live import FLUSHED
from hapticd.measure.recording.provenance import SCHEMA
from hapticd.measure.recording.reading import TEXT, Recording
from hapticd.measure.recording.writer import GROUPS, replay_rows, table


def open_recording(path: Path) -> Recording:
    """The recording in `path`, of whatever kind. ConfigError: it is none, or cannot be read."""
    return _flight(path) if path.suffix == flight_file.SUFFIX else _hdf5(path)


def _hdf5(path: Path) -> Recording:
    h5py = needed("h5py", "record")
    if not path.is_file():
        raise ConfigError(f"{path}: no such file; check the path")
    try:
        file = _opened(h5py, path)
    except OSError as error:
        raise ConfigError(f"{path}: {error}; it is no HDF5 file, or damaged") from error
    if file.attrs.get("schema") != SCHEMA:
        found = file.attrs.get("schema", "without a schema")
        file.close()
        raise ConfigError(f"{path} is no hapticd recording ({found}); expected {SCHEMA}")
    names = sorted(file, key=lambda name: name != FLUSHED)  # of a file that grows meanwhile the count comes before what it counts
    return Recording(path, dict(file.attrs), {name: dict(file[name]) for name in names}, file)


def _opened(h5py: Any, path: Path) -> Any:
    try:
        return h5py.File(path, "r")
    except OSError:  # live, or its recorder died: only a reader who knows that opens it
        return h5py.File(path, "r", swmr=True)


def _flight(path: Path) -> Recording:
    header, records = flight_file.read(path)
    attributes = {
        "schema": SCHEMA, "started_utc": header["written_utc"], "simulated": int(header["simulated"]), "rate_hz": header["rate_hz"],
        "note": f"flight recording: {header['reason']}", "layout": header["layout"], "configuration": json.dumps(header["servo"]),
        "server_version": header["version"], "realtime": json.dumps(header["report"].get("realtime", {})),
    }  # fmt: skip
    rows: dict[str, list[dict[str, Any]]] = {
        "gap": [{"stream": "servo", "row": row, "missing": lost} for row, lost in header["gaps"]],
        "life": [{"row": 0, "epoch": header["epoch"], "mono_unix_offset_ns": header["mono_unix_offset_ns"]}],
        "event": [],
        "request": [], "break": [], "checkpoint": [],
    }  # fmt: skip
    for checkpoint, requests, lost in _messages(header):
        message = {"epoch": header["epoch"], "requests": requests, "break": lost, "checkpoint": checkpoint}
        for name, more in replay_rows(message).items():
            rows[name] += more
    ticks, text = columns(records), b"".join(row["text"] for row in rows["checkpoint"])
    groups: dict[str, Columns] = {
        "servo": {channel.name: as_channel(channel, ticks[channel.name]) for channel in GROUPS["servo"]},
        "probe": {},
        TEXT: {"bytes": np.frombuffer(text, "u1")},
    }
    return Recording(path, attributes, groups | {name: table(name, found) for name, found in rows.items()})


def _messages(header: dict[str, Any]) -> list[tuple[Any, Any, Any]]:
    """The header's lists as messages of topic `flight` would have brought them."""
    states: list[tuple[Any, Any, Any]] = [(checkpoint, [], None) for checkpoint in header["checkpoints"]]
    return [*states, (None, header["requests"], None), *((None, [], tick) for tick in header["breaks"])]
