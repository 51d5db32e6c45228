"""Recordings in other formats: MATLAB 5 (.mat) and comma-separated values."""

import csv
from pathlib import Path
from typing import Any

import numpy as np

from hapticd.errors import HapticdError
from hapticd.measure.recording.libraries import needed
from hapticd.measure.recording.reading import Recording

AT_ONCE = 10_000
GROUPS = ("servo", "probe", "event", "gap", "life")
FRAMES = ("in_frame", "out_frame")


def to_mat(recording: Recording, path: Path) -> Path:
    """One structure per group, and `info` with the attributes. HapticdError: it cannot be written."""
    io = needed("scipy.io", "record")
    content: dict[str, Any] = {
        group: {name: recording.column(group, name) for name in recording.names(group)}
        for group in GROUPS
        if recording.names(group)
    }
    content["info"] = {name: value for name, value in recording.attributes.items() if not isinstance(value, np.ndarray)}
    try:
        io.savemat(path, content, do_compression=True, long_field_names=True, oned_as="column")
    except OSError as error:
        raise HapticdError(f"{path}: {error}") from error
    return path


def to_csv(recording: Recording, path: Path) -> list[Path]:
    """The records in `path`, one line a tick, units in the names; probe samples beside it in NAME.probe.csv."""
    written = [_table(recording, "servo", path)]
    if recording.rows["probe"]:
        written.append(_table(recording, "probe", path.with_suffix(".probe.csv")))
    return written


def _table(recording: Recording, group: str, path: Path) -> Path:
    names = [name for name in recording.names(group) if name not in FRAMES]
    try:
        with path.open("x", newline="") as file:
            lines = csv.writer(file)
            lines.writerow(names)
            for begin in range(0, recording.rows[group], AT_ONCE):
                columns = [recording.column(group, name, begin, begin + AT_ONCE).tolist() for name in names]
                lines.writerows(zip(*columns, strict=True))
    except OSError as error:
        raise HapticdError(f"{path}: {error.strerror}; choose another name") from error
    return path
