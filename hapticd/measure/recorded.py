"""A trial as it was recorded, by whatever recorded it: a board, the batch engine, or another program's file.

Files: .csv with a head line of names; .npz and .mat with named arrays; .h5 with named datasets. Force in N and velocity in
m/s at the port, sampled together; the rate from `rate_hz`, from a column of seconds that runs evenly, or as told.
"""

import csv
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.errors import AnalysisError, ConfigError

FORCES = ("force_n", "torque_n", "force", "torque", "f", "y")
VELOCITIES = ("velocity_m_per_s", "velocity", "v", "u")
TIMES = ("time_s", "time", "t")
RATES = ("rate_hz", "fs")
GAP = 10.0  # periods between two samples of a column of seconds; fewer are those of rounded seconds
BROKEN = (OSError, ValueError, EOFError, MemoryError, csv.Error, BadZipFile, zlib.error)  # what readers say of a broken file


@dataclass(frozen=True, eq=False)
class Recorded:
    """`force_n`, `velocity_m_per_s` (N,) float64 at `rate_hz`. `ended`: why before its time, "" if it was not.

    `max_command_n` is the largest force that was commanded, `command_limit_n` what the device can do; None where not known.
    `more`: what else the source says of itself, for the run's summary.
    """

    force_n: Floats
    velocity_m_per_s: Floats
    rate_hz: float
    origin: str
    simulated: bool
    ended: str = ""
    max_command_n: float | None = None
    command_limit_n: float | None = None
    more: Mapping[str, Any] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Length."""
        return self.force_n.size / self.rate_hz


def read_file(path: Path, force: str = "", velocity: str = "", rate_hz: float | None = None) -> Recorded:
    """The record in `path`; `force`, `velocity`: names of its columns where they are not the usual ones.

    ConfigError for a file that is not there or of an unknown kind; AnalysisError for one without force, velocity or rate.
    """
    readers: dict[str, Callable[[Path], dict[str, Any]]] = {
        ".csv": _csv, ".npz": _npz, ".mat": _mat, ".h5": _hdf5, ".hdf5": _hdf5,
    }  # fmt: skip
    if path.suffix not in readers:
        raise ConfigError(f"{path}: records are read from {', '.join(readers)}; convert it to .csv with a head line of names")
    try:
        columns = readers[path.suffix](path)
    except BROKEN as error:
        raise ConfigError(f"{path}: {error}; a record with named columns was expected") from error
    known = {name.lower(): np.asarray(values, np.float64) for name, values in columns.items() if _is_number(values)}
    y, u = (_named(path, known, told, usual) for told, usual in ((force, FORCES), (velocity, VELOCITIES)))
    rate = _rate(path, known) if rate_hz is None else rate_hz
    if not 0.0 < rate < np.inf:
        raise AnalysisError(f"{path}: a sample rate of {rate:g} Hz; say the right one with --rate-hz")
    return Recorded(y, u, rate, path.name, simulated=False)


def _named(path: Path, known: dict[str, Floats], told: str, usual: tuple[str, ...]) -> Floats:
    for name in (told.lower(),) if told else usual:
        if name in known:
            return _column(path, name, known[name])
    missing = told or f"any of {', '.join(usual)}"
    raise AnalysisError(f"{path}: no column {missing}; it has {', '.join(known) or 'none'}; name it with --force or --velocity")


def _rate(path: Path, known: dict[str, Floats]) -> float:
    for name in RATES:
        if name in known:
            return float(known[name].flat[0])
    for name in TIMES:
        if name in known and known[name].size > 1:
            return _rate_of(path, name, _column(path, name, known[name]))
    raise AnalysisError(f"{path}: the sample rate is not in the file ({', '.join((*RATES, *TIMES))}); say it with --rate-hz")


def _rate_of(path: Path, name: str, time_s: Floats) -> float:
    """Of samples at `time_s` (n,), however few digits it has."""
    steps = np.diff(time_s)
    period_s = float(steps.mean())
    usual_s = float(np.median(steps[steps > 0.0])) if period_s > 0.0 else 0.0
    if not (period_s > 0.0 and steps.min() >= 0.0 and steps.max() <= GAP * min(period_s, usual_s)):
        raise AnalysisError(
            f"{path}: column {name}: seconds do not run evenly, steps of {steps.min():.3g} to {steps.max():.3g} s; samples are "
            "missing or it is no time: cut the record there, or say --rate-hz if it is whole"
        )
    return 1.0 / period_s


def _column(path: Path, name: str, values: Floats) -> Floats:
    if values.size != max(values.shape, default=1):
        raise AnalysisError(f"{path}: {name} has the shape {values.shape}; one column of numbers was expected")
    return values.ravel()


def _is_number(values: Any) -> bool:
    kind = np.asarray(values)
    return kind.dtype.kind in "fiu" and kind.size > 0


def _csv(path: Path) -> dict[str, Any]:
    with path.open(newline="", encoding="utf-8-sig") as file:
        names = [name.strip() for name in next(csv.reader(file), [])]
        lines = [line for line in file if line.strip()]
    if not lines:
        raise ValueError("no samples under a head line")
    values = np.loadtxt(lines, delimiter=",", ndmin=2)
    if values.shape[1] != len(names):
        raise ValueError(f"{len(names)} names over {values.shape[1]} columns")
    return dict(zip(names, values.T, strict=True))


def _npz(path: Path) -> dict[str, Any]:
    found = np.load(path, allow_pickle=False)
    if isinstance(found, np.ndarray):
        raise ValueError("a bare array")
    with found:
        return dict(found)


def _mat(path: Path) -> dict[str, Any]:
    try:
        from scipy.io import loadmat
        from scipy.io.matlab import MatReadError
    except ImportError as error:
        raise ConfigError(f"{path}: .mat files are read with scipy ({error}): install hapticd[reference]") from error
    try:
        return {name: values for name, values in loadmat(path).items() if not name.startswith("__")}
    except NotImplementedError:  # MATLAB 7.3 and later writes HDF5
        return _hdf5(path)
    except (MatReadError, TypeError) as error:  # TypeError: of bytes that are no variable
        raise ValueError(str(error)) from error


def _hdf5(path: Path) -> dict[str, Any]:
    try:
        import h5py
    except ImportError as error:
        raise ConfigError(f"{path}: HDF5 is read with h5py ({error}): install hapticd[record]") from error
    with h5py.File(path) as file:
        return {name: values[()] for name, values in file.items() if isinstance(values, h5py.Dataset)}
