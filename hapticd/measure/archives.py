"""Named columns from .csv, .npz, .mat and .h5 files. A broken one raises what its library does, one of `recorded.BROKEN`.

A text file has a head line of names, then a row a line, apart by comma, semicolon or tab. What parts the columns is
what the head line has most of. With semicolon or tab a comma is a decimal one. Empty lines and lines that begin with #
hold no sample.
"""

import csv
from pathlib import Path
from typing import Any

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.errors import ConfigError
from hapticd.measure.own import Column

MARKS = (",", ";", "\t")


def read_csv(path: Path) -> dict[str, Floats]:
    """Columns (N,) by name. ValueError that names the line and the column where a number was expected, OSError, csv.Error."""
    names, mark, rows = _rows(path)
    if not rows:
        raise ValueError("no samples under a head line")
    try:
        values = np.loadtxt((row for _, row in rows), delimiter=mark, comments=None, ndmin=2)
        return dict(zip(names, values.T, strict=True))
    except ValueError:
        raise ValueError(_wrong(names, mark, rows)) from None


def line_of(path: Path, sample: int) -> int:
    """Number of the line that holds a sample, counted from 0."""
    return _rows(path)[2][sample][0]


def _rows(path: Path) -> tuple[list[str], str, list[tuple[int, str]]]:
    """Names, what parts the columns, and the lines of samples, each with its number in the file."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        head = next(file, "")
        rows = [(number, row) for number, row in enumerate(file, 2) if row.strip() and not row.startswith("#")]
    mark = max(MARKS, key=head.count)
    names = [name.strip() for name in next(csv.reader([head], delimiter=mark), [])]
    return names, mark, rows if mark == "," else [(number, row.replace(",", ".")) for number, row in rows]


def _wrong(names: list[str], mark: str, rows: list[tuple[int, str]]) -> str:
    """The first line that is no row of numbers."""
    for number, row in rows:
        cells = row.strip("\r\n").split(mark)
        if len(cells) != len(names):
            many = "; a decimal comma needs ; or tabs between columns" if mark == "," and len(cells) == 2 * len(names) else ""
            return f"line {number}: {len(cells)} values under {len(names)} names{many}"
        for name, cell in zip(names, cells, strict=True):
            if not _reads(cell):
                return f"line {number}, column {name}: {cell.strip()!r} is no number"
    return "there is something else than numbers in it"


def _reads(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def read_npz(path: Path) -> dict[str, Any]:
    """Of numpy."""
    found = np.load(path, allow_pickle=False)
    if isinstance(found, np.ndarray):
        raise ValueError("a bare array")
    with found:
        return dict(found)


def read_mat(path: Path) -> dict[str, Any]:
    """Of MATLAB, old or new. ConfigError without scipy, or h5py for a new one."""
    try:
        from scipy.io import loadmat
        from scipy.io.matlab import MatReadError
    except ImportError as error:
        raise ConfigError(f"{path}: .mat files are read with scipy ({error}): install hapticd[reference]") from error
    try:
        return {name: values for name, values in loadmat(path).items() if not name.startswith("__")}
    except NotImplementedError:  # MATLAB 7.3 and later writes HDF5
        return read_hdf5(path)
    except (MatReadError, TypeError) as error:  # TypeError: of bytes that are no variable
        raise ValueError(str(error)) from error


def read_hdf5(path: Path) -> dict[str, Any]:
    """The datasets at its root. ConfigError without h5py."""
    try:
        import h5py
    except ImportError as error:
        raise ConfigError(f"{path}: HDF5 is read with h5py ({error}): install hapticd[record]") from error
    with h5py.File(path) as file:
        return {name: values[()] for name, values in file.items() if isinstance(values, h5py.Dataset)}


def structures(content: dict[str, Any]) -> tuple[Column, dict[str, Any]] | None:
    """Columns and attributes of a MATLAB file that this package exported; None of another one."""
    groups = {name: values for name, values in content.items() if getattr(values, "dtype", np.dtype(int)).names}
    if not {"info", "probe", "servo"} <= set(groups):
        return None
    info = groups["info"]
    attributes = {name: _single(info[name][0, 0]) for name in info.dtype.names}
    return (lambda group, name: groups[group][name][0, 0].ravel()), attributes


def _single(values: Any) -> Any:
    return values.ravel()[0] if values.size else ""
