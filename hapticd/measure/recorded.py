"""A trial as it was recorded, by whatever recorded it: a board, the batch engine, or another program's file.

Files: .csv with a head line of names, columns apart by comma, semicolon or tab (a decimal comma only with the latter two); .npz
and .mat with named arrays; .h5 with named datasets. Force in N and velocity in m/s at the port, sampled together; the rate from
`rate_hz`, from a column of seconds that runs evenly, or as told where the file does not say. Told otherwise than the file, the
record is refused: every limit is proportional to the rate or its square.
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
from hapticd.measure.archives import read_hdf5, read_mat, read_npz
from hapticd.measure.csv_file import line_of, read_csv

FORCES = ("force_n", "torque_n", "force", "torque", "f", "y")
VELOCITIES = ("velocity_m_per_s", "velocity", "v", "u")
TIMES = ("time_s", "time", "t")
RATES = ("rate_hz", "fs")
SAME_RATE = 1e-6
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


def nearer(ended: str) -> str:
    """Remedy after a trial that was too short because it ended so; "" where the reason brings its own."""
    return "; go nearer to 0" if ended.startswith(("escape", "saturation", "fault")) else ""


def read_file(path: Path, force: str = "", velocity: str = "", rate_hz: float | None = None) -> Recorded:
    """The record in `path`; `force`, `velocity`: names of its columns where they are not the usual ones.

    `rate_hz`: where the file does not say, else the same. ConfigError for a file that is not there, of an unknown kind, or with
    something else than numbers; AnalysisError for one without force, velocity or rate, with gaps, or with another rate.
    """
    readers: dict[str, Callable[[Path], dict[str, Any]]] = {
        ".csv": read_csv, ".npz": read_npz, ".mat": read_mat, ".h5": read_hdf5, ".hdf5": read_hdf5,
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
    if rate_hz is not None:
        _agrees(path, known, rate_hz)
    return Recorded(y, u, rate, path.name, simulated=False)


def _named(path: Path, known: dict[str, Floats], told: str, usual: tuple[str, ...]) -> Floats:
    for name in (told.lower(),) if told else usual:
        if name in known:
            return _whole(path, name, _column(path, name, known[name]))
    missing = told or f"any of {', '.join(usual)}"
    raise AnalysisError(
        f"{path}: no column {missing}; it has {', '.join(known) or 'none'}; name it with --force-column or --velocity-column"
    )


def _whole(path: Path, name: str, values: Floats) -> Floats:
    if not (good := np.isfinite(values)).all():
        first = int(np.argmin(good))
        raise AnalysisError(
            f"{path}: {_place(path, first)}, column {name}: {values[first]:g}; a gap cannot be analysed, cut the record there"
        )
    return values


def _place(path: Path, sample: int) -> str:
    """Where a sample stands, in words."""
    if path.suffix != ".csv":
        return f"sample {sample + 1}"
    return f"line {line_of(path, sample)}"


def _rate(path: Path, known: dict[str, Floats]) -> float:
    for name in RATES:
        if name in known:
            return float(known[name].flat[0])
    for name in TIMES:
        if name in known and known[name].size > 1:
            return _rate_of(path, name, _column(path, name, known[name]))
    raise AnalysisError(f"{path}: the sample rate is not in the file ({', '.join((*RATES, *TIMES))}); say it with --rate-hz")


def _agrees(path: Path, known: dict[str, Floats], told_hz: float) -> None:
    """AnalysisError if the file says another rate; an uneven column of seconds says none."""
    for name in (*RATES, *TIMES):
        if name not in known:
            continue
        try:
            own_hz = _rate(path, {name: known[name]})
        except AnalysisError:
            continue
        allowed = SAME_RATE if name in RATES else _rounding(known[name].ravel())
        if 0.0 < own_hz < np.inf and abs(told_hz - own_hz) > max(allowed, SAME_RATE) * own_hz:
            raise AnalysisError(
                f"{path}: column {name} says {own_hz:.9g} Hz, --rate-hz {told_hz:.9g} Hz: leave that out, or correct the file"
            )


def _rounding(time_s: Floats) -> float:
    """Relative error of the rate, as the ends of a column of seconds (n,) are known to one step at best."""
    return float(np.diff(time_s).max() / (time_s[-1] - time_s[0]))


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
