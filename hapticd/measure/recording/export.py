"""Recordings in other formats: MATLAB 5 (.mat) and comma-separated values.

What a finished file has beside the records, the probe's signals in SI and seconds, is in the export of an unfinished one too. A
text file ends with a line that begins with # and says where it comes from, SIMULATED or not, and which part is one trial.
"""

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapticd.errors import AnalysisError, HapticdError
from hapticd.measure.own import Stretch, remark, stretch
from hapticd.measure.recording.libraries import needed
from hapticd.measure.recording.pack import derived
from hapticd.measure.recording.reading import Recording

AT_ONCE = 10_000
GROUPS = ("servo", "probe", "event", "gap", "life")
FRAMES = ("in_frame", "out_frame")
Columns = dict[str, NDArray[Any]]


def to_mat(recording: Recording, path: Path) -> Path:
    """One structure per group, and `info` with the attributes. HapticdError: it cannot be written."""
    io = needed("scipy.io", "record")
    content: dict[str, Any] = {
        group: {name: recording.column(group, name) for name in recording.names(group)} | _more(recording, group)
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
    written = [_table(recording, "servo", path, None)]
    if recording.rows["probe"]:
        trial = _trial(recording)
        written.append(_table(recording, "probe", path.with_suffix(".probe.csv"), trial))
    return written


def _trial(recording: Recording) -> Stretch | None:
    try:
        return stretch(recording.column, recording.attributes, recording.path.name)
    except AnalysisError:
        return None


def _more(recording: Recording, group: str) -> Columns:
    """Columns of a finished file that an unfinished one has not yet."""
    known = recording.names(group)
    return {name: values for one, name, _, values in derived(recording) if one == group and name not in known}


def _table(recording: Recording, group: str, path: Path, trial: Stretch | None) -> Path:
    names, more = [name for name in recording.names(group) if name not in FRAMES], _more(recording, group)
    try:
        with path.open("x", newline="") as file:
            lines = csv.writer(file)
            lines.writerow([*names, *more])
            for begin in range(0, recording.rows[group], AT_ONCE):
                end = begin + AT_ONCE
                columns = [recording.column(group, name, begin, end).tolist() for name in names]
                columns += [values[begin:end].tolist() for values in more.values()]
                lines.writerows(zip(*columns, strict=True))
            file.write(remark(recording.attributes, trial))
    except OSError as error:
        raise HapticdError(f"{path}: {error.strerror}; choose another name") from error
    return path
