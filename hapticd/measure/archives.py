"""Named arrays from .npz, .mat and .h5 files. A broken one raises what its library does, one of `recorded.BROKEN`."""

from pathlib import Path
from typing import Any

import numpy as np

from hapticd.errors import ConfigError
from hapticd.measure.own import Column
from hapticd.measure.recording.provenance import SCHEMA


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


def is_recording(path: Path) -> bool:
    """Whether an HDF5 file is a recording of this package, finished or not."""
    try:
        import h5py
    except ImportError:
        return False
    for live in (False, True):
        try:
            with h5py.File(path, "r", swmr=live) as file:
                return bool(file.attrs.get("schema") == SCHEMA)
        except OSError:
            continue
    return False


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
