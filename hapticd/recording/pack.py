"""The final file of a recording, its exports, and the part of it that is one trial.

Trial (`stretch`). A recording is longer than a trial. The trial is its longest stretch in which the
servo was enabled, the probe perturbed the device (if it ever did) and nothing was changed. The
ticks give the rendered environment, the largest command, and the lost slots. The second in which
the device settles after the start of the perturbation is left out, as in a live trial. Limitations:
a recording whose board restarted in the middle; another servo life then begins, which ends the
stretch.

Final file (`pack`). It is compressed, has checksums, and uses HDF5 1.8, which every Octave and
MATLAB reads: it must use filters of HDF5 1.8 alone. The source may be a live file, whose recorder
ended or died, or a flight recording. Both files exist for a while, so the disk must have room for
another one of that size. The final file is written under a temporary name, flushed to the disk and
only then renamed, so it is complete or absent. A live file must stay until then. It is removed
afterwards, if all its bytes were read. A source that cannot be packed is kept.

Exports (`to_mat`, `to_csv`) are MATLAB 5 (.mat) and comma-separated values. The computed columns of
a finished file, the probe's signals in SI and seconds, are in the export of an unfinished one too.
A text file has no attributes. Its last line (`remark`) begins with # and contains its origin,
SIMULATED or not, and for the probe's samples which part is the trial.
"""

import csv
import json
import os
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from hapticd.core.arrays import Flags
from hapticd.core.errors import AnalysisError, ConfigError, HapticdError
from hapticd.core.extras import need
from hapticd.core.units import NS_PER_S
from hapticd.mailbox.layout import LOST_SLOTS, State
from hapticd.recording.file import DATASETS, GROUP, Recording, energies, open_recording
from hapticd.recording.live import SUFFIX, require_finished
from hapticd.recording.provenance import SCHEMA
from hapticd.settings.toml import regular

__all__ = [
    "JSON_ATTRIBUTES",
    "REMARK_ATTRIBUTES",
    "ReadColumn",
    "Stretch",
    "pack",
    "read_remark",
    "stretch",
    "summary",
    "to_csv",
    "to_mat",
]

# --- trial ----------------------------------------------------------------------------------------

SETTLE_S = 1.0  # left out after the perturbation began
REMARK = f"# {SCHEMA} "
TAIL_BYTES = 8192  # at the end of a text file that contain the remark
RENDERED_COLUMNS = (
    "stiffness_n_per_m",
    "virtual_damping_ns_per_m",
    "mass_kg",
    "active_damping_asked_ns_per_m",
)
JSON_ATTRIBUTES = ("calibration_doubts", "certificate")  # their text is JSON
REMARK_ATTRIBUTES = (
    "device_name",
    "device_serial",
    "started_utc",
    "uuid",
    "config_hash",
    "note",
    *JSON_ATTRIBUTES,
)


ReadColumn = Callable[[str, str], Any]  # of a group and a name: its values, one a row


@dataclass(frozen=True, slots=True)
class Stretch:
    """The part of a recording that is one trial. An exported file carries these fields by name."""

    first: int  # row of the probe
    after: int  # row after the last
    environment: tuple[float, float, float]  # rendered K [N/m], B [N s/m], M [kg]
    active_damping_ns_per_m: float  # active damping
    max_command_n: float  # largest |force|
    command_limit_n: float
    lost_slots: int
    slots: int  # of 1 ms, the lost ones included
    begin_s: float  # from the first row of the probe
    end_s: float


def remark(attributes: Mapping[str, Any], trial: Stretch | None) -> str:
    """Return the last line of a text file: its origin, and the trial in the probe's."""
    content: dict[str, Any] = {
        name: attributes[name] for name in REMARK_ATTRIBUTES if name in attributes
    }
    content["simulated"] = int(attributes["simulated"])
    if trial is not None:
        content["trial"] = asdict(trial)
    return f"{REMARK}{json.dumps(content, default=np.generic.item)}\n"


def stretch(column: ReadColumn, attributes: Mapping[str, Any], name: str) -> Stretch:
    """Return the longest part of a recording in which nothing was changed. AnalysisError without
    ticks or probe samples.
    """
    probe_ns = np.asarray(column("probe", "time_ns"), np.int64)
    tick_ns = np.asarray(column("servo", "time_ns"), np.int64)
    if not probe_ns.size or not tick_ns.size:
        raise AnalysisError(
            f"{name}: no samples of the probe in it; record while a board with probe inputs is"
            " connected"
        )
    begin, end = _longest(column)
    settle_ns = round(SETTLE_S * NS_PER_S)
    if not begin or tick_ns[end] - tick_ns[begin] <= 2 * settle_ns:
        settle_ns = 0
    first, after = np.searchsorted(probe_ns, [tick_ns[begin] + settle_ns, tick_ns[end] + 1])
    stiffness, damping, mass, added = (float(column("servo", one)[end]) for one in RENDERED_COLUMNS)
    if column("servo", "state")[end] != State.ENABLED:
        stiffness = damping = mass = 0.0
    lost = (
        int(column("servo", "lost_slots")[end] - column("servo", "lost_slots")[begin]) % LOST_SLOTS
    )
    force = np.abs(np.asarray(column("servo", "force_n"), np.float64)[begin : end + 1])
    servo = json.loads(str(attributes["configuration"]))
    return Stretch(
        int(first),
        int(after),
        (stiffness, damping, mass),
        added,
        float(force.max()),
        min(servo["safety"]["force_limit_n"], servo["device"]["force_limit_n"]),
        lost,
        int(column("servo", "tick")[end] - column("servo", "tick")[begin]) + 1 + lost,
        float(probe_ns[first : first + 1].sum() - probe_ns[0]) / NS_PER_S,
        float(probe_ns[after - 1] - probe_ns[0]) / NS_PER_S,
    )


def _longest(column: ReadColumn) -> tuple[int, int]:
    """Return first and last tick of the longest run that is fit for a trial."""
    fit = _fit(column)
    keys = np.stack(
        [np.asarray(column("servo", name), np.float64) for name in ("revision", *RENDERED_COLUMNS)]
    )
    changed = np.flatnonzero((np.diff(keys, axis=1) != 0.0).any(axis=0) | (np.diff(fit) != 0)) + 1
    lives = np.asarray(column("life", "row"), np.int64)
    edges = np.unique(np.concatenate(([0, fit.size], changed, lives)))
    lengths = np.where(fit[edges[:-1]], np.diff(edges), 0)
    longest = int(np.argmax(lengths))
    return int(edges[longest]), int(edges[longest + 1]) - 1


def _fit(column: ReadColumn) -> Flags:
    """Return ticks (n,) that were enabled and perturbed, or only enabled; all if none was."""
    enabled = (np.asarray(column("servo", "state")) == State.ENABLED) & (
        np.asarray(column("servo", "gain")) >= 1.0
    )
    perturbed = enabled & (np.asarray(column("servo", "perturbing")) != 0)
    found = next((fit for fit in (perturbed, enabled) if fit.any()), np.ones_like(enabled))
    return np.asarray(found)


# --- final file -----------------------------------------------------------------------------------

CHUNK_ROWS = 4096
ROWS_AT_ONCE = 1 << 18  # copied from the source
STORAGE = {"compression": "gzip", "compression_opts": 4, "shuffle": True, "fletcher32": True}
FINAL = ".h5"
LONGEST_TEXT = 60_000  # bytes of an attribute; an HDF5 header holds 65,535
LINES_AT_ONCE = 10_000  # of a text file
GROUPS = ("servo", "probe", GROUP, "event", "gap", "life")  # of a MATLAB file
FRAMES = ("in_frame", "out_frame")  # not in a text file


def free_bytes(folder: Path) -> int:
    """Return the free space of the disk."""
    return shutil.disk_usage(folder).free


def pack(
    source: Path,
    final: Path,
    recovered: bool = False,
    free_bytes: Callable[[Path], int] = free_bytes,
) -> dict[str, Any]:
    """Write `final` from `source`, completely or not at all. Return {file, records, seconds,
    missing, bytes} and the rest of `summary`. HapticdError if it cannot be written; `source` is
    then kept.
    """
    import h5py

    if final.exists():
        raise HapticdError(f"{final} exists; move it away or choose another name")
    if source.name.endswith(SUFFIX):
        require_finished(source)
    _check_room(source, final, free_bytes)
    fresh = final.with_name(f".{final.name}.{os.getpid()}")
    with open_recording(source) as recording:
        try:
            found = summary(recording)
            with h5py.File(fresh, "w", libver=("earliest", "v108")) as file:
                _write(file, recording, found, recovered)
            with fresh.open("rb") as written:
                os.fsync(written.fileno())
            fresh.replace(final)
        except (OSError, RuntimeError, LookupError, ValueError) as error:
            raise HapticdError(
                f"{final}: {error}; free some space, then `hapticd rec recover {source}`"
            ) from error
        finally:
            fresh.unlink(missing_ok=True)
    if source.name.endswith(SUFFIX) and not recording.dropped_bytes:
        source.unlink()
    return {"file": str(final), **found, "bytes": final.stat().st_size}


def _check_room(source: Path, final: Path, free_bytes: Callable[[Path], int]) -> None:
    """Raise HapticdError without room for a file as large as `source` next to it."""
    needed = regular(source).stat().st_size
    free = free_bytes(final.parent)
    if free < needed:
        raise HapticdError(
            f"{final}: packing needs up to {needed / 1e6:.0f} MB, {free / 1e6:.0f} MB are free;"
            f" {source} stays: free some space, then `hapticd rec recover {source}`"
        )


def summary(recording: Recording) -> dict[str, Any]:
    """Return records, probe samples, seconds, missing records, servo lives."""
    first_ns, last_ns = (
        int(np.sum(recording.column("servo", "time_ns", row, row + 1)))
        for row in (0, max(0, recording.rows["servo"] - 1))
    )
    return {
        "records": recording.rows["servo"],
        "probe_samples": recording.rows["probe"],
        "seconds": (last_ns - first_ns) / NS_PER_S,
        "missing": recording.missing,
        "lost_slots": _lost_slots(recording),
        "lives": recording.rows["life"],
        "dropped_bytes": recording.dropped_bytes,
        "simulated": bool(recording.attributes["simulated"]),
    }


def of_fixed_length(value: Any) -> Any:
    """Return `value` of an attribute, with text as fixed-length UTF-8. HDF5 stores text of variable
    length in a heap without a checksum, and hangs or crashes on a damaged heap. Only text too long
    for a header is not converted.
    """
    data = value.encode() if isinstance(value, str) else b""
    if not isinstance(value, str) or len(data) > LONGEST_TEXT:
        return value
    return np.array(data, f"S{max(1, len(data))}")


def _lost_slots(recording: Recording) -> int:
    """Return the number of periods without a tick, because the host was late; the counter of each
    life begins at 0.
    """
    counts = recording.column("servo", "lost_slots").astype(np.int64)
    more = np.diff(counts)
    return int(np.where(more < 0, counts[1:], more).sum())


def _write(file: Any, recording: Recording, found: dict[str, Any], recovered: bool) -> None:
    about = {
        **recording.attributes,
        "recovered": int(recovered),
        "packed_utc": datetime.now(UTC).isoformat(),
        "summary": json.dumps(found),
    }
    for name, value in about.items():
        file.attrs[name] = of_fixed_length(value)
    for group, rows in recording.rows.items():
        target = file.create_group(group)
        for name in recording.names(group):
            _copy(target, name, recording, group, rows)
    if GROUP not in recording.rows:
        with suppress(ConfigError):  # records of another version
            _write_energy(file, recording)


def _write_energy(file: Any, recording: Recording) -> None:
    sums = np.concatenate(
        [np.empty((0, len(DATASETS))), *(part for _, part in energies(recording))]
    )
    target = file.create_group(GROUP)
    for name, column in zip(DATASETS, sums.T, strict=True):
        _dataset(target, name, column.shape, column.dtype, "J")[:] = column


def _copy(target: Any, name: str, recording: Recording, group: str, rows: int) -> None:
    first = recording.column(group, name, 0, 1)
    unit = recording.unit(group, name)
    dataset = _dataset(target, name, (rows, *first.shape[1:]), first.dtype, unit)
    for begin in range(0, rows, ROWS_AT_ONCE):
        end = min(begin + ROWS_AT_ONCE, rows)
        dataset[begin:end] = recording.column(group, name, begin, end)


def _dataset(group: Any, name: str, shape: tuple[int, ...], kind: np.dtype[Any], unit: str) -> Any:
    rows, *row = shape
    # HDF5 does not allow empty chunks
    storage = {**STORAGE, "chunks": (min(CHUNK_ROWS, rows), *row)} if rows else {}
    dataset = group.create_dataset(name, shape, kind, **storage)
    dataset.attrs["units"] = of_fixed_length(unit)
    return dataset


# --- exports --------------------------------------------------------------------------------------


def to_mat(recording: Recording, path: Path) -> Path:
    """Write one structure per group, and `info` with the attributes. HapticdError if it cannot be
    written.
    """
    io = need("scipy.io", "a .mat file")
    content: dict[str, Any] = {
        group: {name: recording.column(group, name) for name in names}
        for group in GROUPS
        if (names := recording.names(group))
    }
    content["info"] = {
        name: value
        for name, value in recording.attributes.items()
        if not isinstance(value, np.ndarray)
    }
    try:
        io.savemat(path, content, do_compression=True, long_field_names=True, oned_as="column")
    except OSError as error:
        raise HapticdError(f"{path}: {error}") from error
    return path


def to_csv(recording: Recording, path: Path) -> list[Path]:
    """Write the records to `path`, one line per tick, units in the names, and probe samples to
    NAME.probe.csv next to it.
    """
    written = [_table(recording, "servo", path, remark(recording.attributes, None))]
    if recording.rows["probe"]:
        trial = None
        with suppress(AnalysisError):
            trial = stretch(recording.column, recording.attributes, recording.path.name)
        beside = path.with_suffix(".probe.csv")
        written.append(_table(recording, "probe", beside, remark(recording.attributes, trial)))
    return written


def _table(recording: Recording, group: str, path: Path, remark: str) -> Path:
    names = [name for name in recording.names(group) if name not in FRAMES]
    try:
        with path.open("x", newline="") as file:
            lines = csv.writer(file)
            lines.writerow(names)
            for begin in range(0, recording.rows[group], LINES_AT_ONCE):
                end = begin + LINES_AT_ONCE
                columns = [recording.column(group, name, begin, end).tolist() for name in names]
                lines.writerows(zip(*columns, strict=True))
            file.write(remark)
    except OSError as error:
        raise HapticdError(f"{path}: {error.strerror}; choose another name") from error
    return path


def read_remark(path: Path) -> dict[str, Any] | None:
    """Return the content of the last line of a text file; None if this package did not write it.
    ConfigError if the line was changed. OSError if the file cannot be read.
    """
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - TAIL_BYTES))
        last = file.read().decode(errors="replace").strip().splitlines()[-1:]
    if not last or not last[0].startswith(REMARK):
        return None
    try:
        return dict(json.loads(last[0].removeprefix(REMARK)))
    except (ValueError, TypeError) as error:
        raise ConfigError(
            f"{path}: its last line was changed ({error}); export it again"
        ) from error
