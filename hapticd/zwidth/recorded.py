"""A recorded trial from any source: a board, the batch engine, or another program's file.

Files: .csv with a header line of names and one row per line, separated by the most frequent of
comma, semicolon and tab in the header line. With semicolon or tab a comma is a decimal one; empty
lines and lines that begin with # are skipped. .npz and .mat with named arrays; .h5 with named
datasets. Force is in N and velocity in m/s at the port, sampled together. The rate comes from
`rate_hz`, from a column of seconds (`timestamps`), or from the user if the file has neither. If two
differ, the record is refused: every limit is proportional to the rate or its square. Missing rows,
as shown by a column of seconds or by the counter that the user names, are filled and counted as the
lost samples of a live trial are (`watch`). A column is never taken as a counter because of its
name.

Limitations: channels that were not sampled together, or wrong units that are too close to be
detected (`signal.channels`).
"""

import csv
import json
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import BadZipFile

import numpy as np

from hapticd.core.arrays import Floats, Integers
from hapticd.core.environment import Environment
from hapticd.core.errors import AnalysisError, ConfigError, HapticdError
from hapticd.core.extras import need
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.recording.file import open_recording
from hapticd.recording.pack import ReadColumn, read_remark
from hapticd.settings.toml import SAMPLES_BYTES, regular
from hapticd.zwidth.store import (
    LOSSES_BY,
    MARK_SAMPLE,
    RECORD_H5,
    RESTS_ON,
    SUMMARY,
    LossesBy,
    TrialRecord,
    end_of_plain,
    origin_of,
    read_summary,
    record_path,
)
from hapticd.zwidth.timestamps import (
    SLOWEST_HZ,
    Sampling,
    counted,
    of_recording,
    of_remark,
    sampling,
    unwrapped,
)
from hapticd.zwidth.watch import COUNTS, in_even_time

__all__ = ["read_file"]

PROBE_COLUMNS = {"index", "torque", "velocity", "time_ns"}  # columns of a table of probe samples
SERVO_COLUMNS = {"tick", "revision", "force_n"}  # columns of a table of ticks

MARKS = (",", ";", "\t")  # between columns
FORCES = ("force_n", "torque_n", "force", "torque", "f", "y")
VELOCITIES = ("velocity_m_per_s", "velocity", "v", "u")
TIMES = {
    "time_s": 1.0,
    "t_s": 1.0,
    "time": 1.0,
    "t": 1.0,
    "time_ms": 1e-3,
    "time_us": 1e-6,
    "time_ns": 1e-9,
}  # in seconds
RATES = ("rate_hz", "fs")
SAME_RATE = 1e-6
ALIKE = 0.01  # rates of a file's rate and its times
# N, m/s: values beyond them are not a measurement
LARGEST = 1e12
SMALLEST = 1e-20
BROKEN = (
    OSError,
    ValueError,
    EOFError,
    MemoryError,
    csv.Error,
    BadZipFile,
    zlib.error,
)  # errors of readers for a broken file


def read_file(
    path: Path,
    force: str = "",
    velocity: str = "",
    rate_hz: float | None = None,
    counter: str = "",
) -> TrialRecord:
    """Return the record in `path`, or in the run folder `path`. `force`, `velocity`: names of its
    columns if they are not the usual ones; `counter`: the column that numbers its samples. Files of
    this package (`timestamps`) need none of them.

    `rate_hz`: required if the file has no rate, otherwise equal to it. ConfigError for a missing
    file, one of an unknown kind, or one with other content than numbers; AnalysisError for one
    without force, velocity, rate or that counter, with gaps, or with another rate.
    """
    if path.is_dir():
        path = record_path(path)
    if path.suffix not in READERS:
        raise ConfigError(
            f"{path}: records are read from {', '.join(READERS)}; convert it to .csv with a header"
            " line of names"
        )
    hdf5 = READERS[path.suffix] is _read_hdf5
    regular(path, None if hdf5 else SAMPLES_BYTES)  # recordings are read column by column
    recording = hdf5 and is_recording(path)
    columns = {} if recording else _columns(path)
    ours = None
    with _whole_file(path):
        if recording:
            with open_recording(path) as file:
                ours = of_recording(file.column, file.attributes, path.name)
        elif not (force or velocity or counter):
            ours = _exported(path, columns)
    if ours is None:
        recorded = _foreign(path, columns, (force, velocity), rate_hz, counter)
        with _whole_file(path):
            return _of_trial(path, columns, recorded)
    if counter:
        raise AnalysisError(
            f"{path}: a recording numbers its samples itself, --counter {counter}: omit that option"
        )
    if rate_hz is not None and abs(rate_hz - ours.rate_hz) > SAME_RATE * ours.rate_hz:
        raise AnalysisError(
            f"{path}: a recording at {ours.rate_hz:g} Hz, --rate-hz {rate_hz:.9g} Hz: leave"
            " that out"
        )
    return ours


@contextmanager
def _whole_file(path: Path) -> Iterator[None]:
    """Raise ConfigError if part of a file of this package is missing or was changed."""
    try:
        yield
    except (*BROKEN, LookupError, TypeError, AttributeError) as error:
        raise ConfigError(
            f"{path}: hapticd wrote it, but it is damaged ({error!r}); copy it again"
            " from its origin"
        ) from error


def _exported(path: Path, columns: dict[str, Any]) -> TrialRecord | None:
    """Return the trial in an export of a recording; None for another file."""
    if path.suffix == ".mat":
        found = _structures(columns)
        return of_recording(*found, path.name) if found else None
    if set(columns) >= PROBE_COLUMNS and "torque_n" not in columns:
        raise AnalysisError(
            f"{path}: counts of a recording that was not finished; finish it with `hapticd rec"
            " recover`, then export"
        )
    remark = read_remark(path) if path.suffix == ".csv" else None
    if remark is not None or set(columns) >= SERVO_COLUMNS:
        return of_remark(lambda _, name: columns[name], remark or {}, path.name)
    return None


def _of_trial(path: Path, columns: dict[str, Any], recorded: TrialRecord) -> TrialRecord:
    """Return `recorded` with the details from a trial's run folder, or from the record itself."""
    stated: Mapping[str, Any] = {}
    if "trial" in columns:
        stated = json.loads(np.asarray(columns["trial"]).item())
    elif path.name == RECORD_H5 and (path.parent / SUMMARY).is_file():
        stated = origin_of(read_summary(path.parent))
    if "environment" not in stated or "simulated" not in stated:
        return recorded
    return replace(
        recorded,
        origin=f"{path.name} of a trial: {stated['origin']}",
        simulated=stated["simulated"],
        ended=end_of_plain(stated.get("ended")),
        max_command_n=stated.get("max_command_n"),
        command_limit_n=stated.get("command_limit_n"),
        rendered=Environment(active_damping_ns_per_m=stated["active_damping_ns_per_m"]).with_free(
            tuple(stated["environment"].values())
        ),
        more={name: stated[name] for name in (*COUNTS, MARK_SAMPLE, *RESTS_ON) if name in stated},
    )


class ForeignSamples(NamedTuple):
    """The record of another system: channels (n,) at 4 kHz of its own clock."""

    force: Floats
    velocity: Floats
    place: Integers  # (n,) of each row on its clock, from 0, from its counter or its times
    first: int  # number of the first row by its counter; 0 without one
    rate_hz: float  # as given in the file
    losses_by: LossesBy
    columns: Mapping[str, Floats]  # every column of numbers, by its name in lower case


def read_foreign(
    path: Path, force: str, velocity: str, rate_hz: float | None, counter: str = ""
) -> ForeignSamples:
    """Return the record of another system in `path`; 4 kHz if neither `rate_hz` nor the file gives
    the rate. Names and errors as `read_file`.
    """
    regular(path, SAMPLES_BYTES)
    if path.suffix not in READERS:
        raise ConfigError(f"{path}: files are read from {', '.join(READERS)}; convert it to .csv")
    return _samples(path, _columns(path), (force, velocity), rate_hz, counter, PROBE_RATE_HZ)


def _samples(
    path: Path,
    columns: dict[str, Any],
    stated: tuple[str, str],
    rate_hz: float | None,
    counter: str,
    usual_hz: float | None = None,
) -> ForeignSamples:
    """Return the record of any other program; `usual_hz`: the rate if the file does not give it."""
    known = _numbers(columns)
    y, u = (
        _channel(path, known, name, usual)
        for name, usual in zip(stated, (FORCES, VELOCITIES), strict=True)
    )
    if y.size != u.size:
        raise AnalysisError(
            f"{path}: {y.size} samples of force and {u.size} of velocity; both were expected,"
            " sampled together"
        )
    if rate_hz is None and not any(name in known for name in (*RATES, *TIMES)):
        rate_hz = usual_hz
    found = _sampling(path, known, rate_hz, y.size)
    place = np.arange(y.size) if found.place is None else found.place
    first = 0
    losses: LossesBy = "times" if found.shows_losses else "nothing"
    if counter:
        place, first = _counted(path, counter, known, y.size)
        losses = "counter"
    return ForeignSamples(y, u, place, first, found.rate_hz, losses, known)


def _counted(path: Path, name: str, known: dict[str, Floats], count: int) -> tuple[Integers, int]:
    """Return positions (n,) from 0 of `count` rows from the counter that the user names, and its
    first number.
    """
    if name.lower() not in known:
        raise AnalysisError(
            f"{path}: no column {name}; it has {', '.join(known)}; name its counter of samples with"
            " --counter, or omit that option"
        )
    counts = _column(path, name, known[name.lower()])
    if counts.size != count:
        raise AnalysisError(
            f"{path}: column {name} has {counts.size} values, the force {count}: correct the file"
        )
    try:
        return counted(name, counts)
    except AnalysisError as error:
        raise AnalysisError(f"{path}: {error}") from error


def _numbers(columns: dict[str, Any]) -> dict[str, Floats]:
    """Return columns of numbers, by their names in lower case; clocks of times unwrapped."""
    known = {
        name.lower(): np.asarray(values, np.float64)
        for name, values in columns.items()
        if np.size(values) and np.asarray(values).dtype.kind in "fiu"
    }
    times = {
        name: unwrapped(values.ravel()).reshape(values.shape)
        for name, values in known.items()
        if name in TIMES
    }
    return known | times


def _foreign(
    path: Path,
    columns: dict[str, Any],
    stated: tuple[str, str],
    rate_hz: float | None,
    counter: str,
) -> TrialRecord:
    """Return the record of any other program."""
    found = _samples(path, columns, stated, rate_hz, counter)
    recorded = TrialRecord(
        found.force, found.velocity, found.rate_hz, path.name, False,
        more={LOSSES_BY: found.losses_by},
    )  # fmt: skip
    shows_gaps = counter or found.place[-1] >= found.place.size
    return in_even_time(recorded, found.place) if shows_gaps else recorded


def _channel(path: Path, known: dict[str, Floats], stated: str, usual: tuple[str, ...]) -> Floats:
    name = next((name for name in ((stated.lower(),) if stated else usual) if name in known), None)
    if name is None:
        missing = stated or f"any of {', '.join(usual)}"
        raise AnalysisError(
            f"{path}: no column {missing}; it has {', '.join(known) or 'none'}; name it with"
            " --force-column or --velocity-column"
        )
    values = _column(path, name, known[name])
    if not (good := np.isfinite(values)).all():
        first = int(np.argmin(good))
        csv_file = path.suffix == ".csv"
        place = f"line {_rows(path)[2][first][0]}" if csv_file else f"sample {first + 1}"
        raise AnalysisError(
            f"{path}: {place}, column {name}: {values[first]:g}; a gap cannot be analysed, cut the"
            " record there"
        )
    most = float(np.abs(values).max())
    if most > LARGEST or 0.0 < most < SMALLEST:
        raise AnalysisError(
            f"{path}: column {name} has values up to {most:.3g}; N and m/s were expected"
        )
    return values


def _sampling(
    path: Path, known: dict[str, Floats], stated_hz: float | None, count: int
) -> Sampling:
    """Return the rate, from the user or the file, and the positions of the rows if its times show
    gaps.
    """
    named = [(name, _single(path, name, known[name])) for name in RATES if name in known]
    times = next((name for name in TIMES if name in known and known[name].size > 1), "")
    by_times, why = _by_times(path, times, known[times], count) if times else (None, "")
    if stated_hz is None and not named:
        if by_times is not None:
            return by_times
        if count == 1:
            raise AnalysisError(f"{path} has one row of numbers; a record has one for each sample")
        raise AnalysisError(
            why
            or f"{path}: the sample rate is not in the file ({', '.join((*RATES, *TIMES))}); say it"
            " with --rate-hz"
        )
    rate_hz = stated_hz if stated_hz is not None else named[0][1]
    _usable(path, rate_hz)
    if stated_hz is not None:
        _agrees(path, stated_hz, named, SAME_RATE)
    if stated_hz is not None and by_times is not None:
        rounding = _rounding(known[times].ravel())
        _agrees(path, stated_hz, [(times, by_times.rate_hz)], max(SAME_RATE, rounding))
    if by_times is None:
        return Sampling(rate_hz, shows_losses=False)
    if abs(by_times.rate_hz - rate_hz) > ALIKE * rate_hz:
        raise AnalysisError(
            f"{path}: a rate of {rate_hz:.9g} Hz, but its times say {by_times.rate_hz:.9g} Hz:"
            " correct the file"
        )
    return replace(by_times, rate_hz=rate_hz)


def _agrees(path: Path, stated_hz: float, said: list[tuple[str, float]], allowed: float) -> None:
    for name, own_hz in said:
        if 0.0 < own_hz < np.inf and abs(stated_hz - own_hz) > allowed * own_hz:
            raise AnalysisError(
                f"{path}: column {name} says {own_hz:.9g} Hz, --rate-hz {stated_hz:.9g} Hz: leave"
                " that out, or correct the file"
            )


def _single(path: Path, name: str, values: Floats) -> float:
    """Return the single value of a column."""
    if np.isfinite(values).all() and np.ptp(values) > SAME_RATE * np.abs(values).max():
        raise AnalysisError(
            f"{path}: column {name} has values from {values.min():g} to {values.max():g} Hz; one"
            " rate was expected"
        )
    return float(values.flat[0])


def _usable(path: Path, rate_hz: float) -> None:
    if not 0.0 < rate_hz < np.inf:
        raise AnalysisError(
            f"{path}: a sample rate of {rate_hz:g} Hz; give the rate with --rate-hz"
        )
    if rate_hz < SLOWEST_HZ:
        likely = (
            f"the period of {1.0 / rate_hz:.6g} Hz in seconds"
            if rate_hz < 0.01
            else f"{1e3 * rate_hz:g} Hz, in kHz"
        )
        raise AnalysisError(
            f"{path}: a sample rate of {rate_hz:g} Hz; it looks like {likely}: give the rate in Hz"
            " with --rate-hz"
        )


def _by_times(path: Path, name: str, values: Floats, count: int) -> tuple[Sampling | None, str]:
    """Return the sampling from a column of times, or the reason why there is none."""
    if values.size != count:
        return (
            None,
            f"{path}: column {name} has {values.size} values, the force {count}: correct the file",
        )
    try:
        return sampling(TIMES[name] * _column(path, name, values)), ""
    except AnalysisError as error:
        return None, f"{path}: column {name}: {error}"


def _rounding(time_s: Floats) -> float:
    """Return the relative error of the rate: the ends of a column of times (n,) are known to one
    step at best.
    """
    return float(np.median(np.diff(time_s)[np.diff(time_s) > 0.0]) / (time_s[-1] - time_s[0]))


def _column(path: Path, name: str, values: Floats) -> Floats:
    if values.size != max(values.shape, default=1):
        raise AnalysisError(
            f"{path}: {name} has the shape {values.shape}; one column of numbers was expected"
        )
    return values.ravel()


# --- kinds of files -------------------------------------------------------------------------------


def _columns(path: Path) -> dict[str, Any]:
    """Return named columns of a file, or arrays of other shapes. ConfigError for a broken one."""
    try:
        return READERS[path.suffix](path)
    except BROKEN as error:
        raise ConfigError(f"{path}: {error}; a record with named columns was expected") from error


def _read_csv(path: Path) -> dict[str, Floats]:
    """Return columns (N,) by name. ValueError, with line and column, where a number was expected;
    OSError, csv.Error.
    """
    names, mark, rows = _rows(path)
    if not rows:
        raise ValueError("no samples under a header line")
    try:
        values = np.loadtxt((row for _, row in rows), delimiter=mark, comments=None, ndmin=2)
        return dict(zip(names, values.T, strict=True))
    except ValueError:
        raise ValueError(_wrong(names, mark, rows)) from None


def _rows(path: Path) -> tuple[list[str], str, list[tuple[int, str]]]:
    """Return the names of the columns, their separator, and the lines of samples, each with its
    number in the file.
    """
    with path.open(newline="", encoding="utf-8-sig") as file:
        head = next(file, "")
        rows = [
            (number, row)
            for number, row in enumerate(file, 2)
            if row.strip() and not row.startswith("#")
        ]
    mark = max(MARKS, key=head.count)
    names = [name.strip() for name in next(csv.reader([head], delimiter=mark), [])]
    if mark != ",":
        rows = [(number, row.replace(",", ".")) for number, row in rows]
    return names, mark, rows


def _wrong(names: list[str], mark: str, rows: list[tuple[int, str]]) -> str:
    """Describe the first line that is not a row of numbers."""
    for number, row in rows:
        cells = row.strip("\r\n").split(mark)
        if len(cells) != len(names):
            many = (
                "; a decimal comma needs ; or tabs between columns"
                if mark == "," and len(cells) == 2 * len(names)
                else ""
            )
            return f"line {number}: {len(cells)} values under {len(names)} names{many}"
        for name, cell in zip(names, cells, strict=True):
            try:
                float(cell)
            except ValueError:
                return f"line {number}, column {name}: {cell.strip()!r} is no number"
    return "there is something else than numbers in it"


def _read_npz(path: Path) -> dict[str, Any]:
    """The columns of an .npz file, by name."""
    found = np.load(path, allow_pickle=False)
    if isinstance(found, np.ndarray):
        raise ValueError("a bare array")
    with found:
        return dict(found)


def _read_mat(path: Path) -> dict[str, Any]:
    """The variables of a MATLAB file, old or new, by name."""
    io = need("scipy.io", "a .mat file")
    try:
        return {
            name: values for name, values in io.loadmat(path).items() if not name.startswith("__")
        }
    except NotImplementedError:  # MATLAB 7.3 and later writes HDF5
        return _read_hdf5(path)
    except (io.matlab.MatReadError, TypeError) as error:  # TypeError: bytes are not a variable
        raise ValueError(str(error)) from error


def _read_hdf5(path: Path) -> dict[str, Any]:
    """The datasets at its root."""
    import h5py

    with h5py.File(path) as file:
        return {
            name: values[()] for name, values in file.items() if isinstance(values, h5py.Dataset)
        }


READERS: dict[str, Callable[[Path], dict[str, Any]]] = {
    ".csv": _read_csv, ".npz": _read_npz, ".mat": _read_mat, ".h5": _read_hdf5, ".hdf5": _read_hdf5,
}  # fmt: skip


def _structures(content: dict[str, Any]) -> tuple[ReadColumn, dict[str, Any]] | None:
    """Return columns and attributes of a MATLAB file of this package; None for another one."""
    groups = {
        name: values
        for name, values in content.items()
        if getattr(values, "dtype", np.dtype(int)).names
    }
    if not {"info", "probe", "servo"} <= set(groups):
        return None
    stated = {name: groups["info"][name][0, 0] for name in groups["info"].dtype.names}
    attributes = {name: values.ravel()[0] if values.size else "" for name, values in stated.items()}
    return (lambda group, name: groups[group][name][0, 0].ravel()), attributes


def is_recording(path: Path) -> bool:
    """Whether a file is a recording of this package, finished or not."""
    try:
        with open_recording(path):
            return True
    except HapticdError:
        return False
