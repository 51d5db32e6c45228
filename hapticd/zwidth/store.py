"""What a procedure writes to disk, and how it reports its progress.

Results are kept in a folder for each run, and in an append-only file of trials, by which an
interrupted map or limit continues:

    run folder     run.json (verdict, conditions, provenance); of a trial record.h5 and
                   impedance.csv; figures
    trial store    one JSON object a line, keyed by the SHA-256 of everything that the trial's
                   outcome depends on

A line is written at once and flushed, so that Ctrl-C or a dead machine costs at most the trials in
flight; a torn last line is not read. A run folder holds one run: whoever writes another there
removes what the one before left, but for the store, which several runs share, and files of other
names. JSON knows no nan and no infinity: both become null, and null is read as nan.

Results become objects that JSON can carry (`plain`): arrays become lists, complex numbers pairs,
what is not finite null.

Limitations: two processes that append to one store at the same time; their lines may then
interleave, and such lines are not read.
"""

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic_core import to_jsonable_python

from hapticd.core.arrays import Floats
from hapticd.core.environment import Environment
from hapticd.core.errors import AnalysisError, ConfigError

__all__ = [
    "FIGURE_KINDS",
    "EndReason",
    "Progress",
    "Steps",
    "TrialRecord",
    "TrialStore",
    "csv_text",
    "fingerprint",
    "read_summary",
    "silent",
    "to_json",
    "write_run",
]

# --- why a trial ended ----------------------------------------------------------------------------


class EndReason(StrEnum):
    """What ended a trial before its time; the values are those of run.json. The reason and the code
    of the fault decide what follows: the verdict, another trial, an exit code.
    """

    ESCAPE = "escape"
    SATURATION = "saturation"
    TRAVEL = "travel"
    HEAT = "heat"
    DECIDED = "decided"
    SLOW_START = "slow_start"
    CHANGED = "changed"
    DISABLED = "disabled"
    STOPPED = "stopped"
    FAULT = "fault"
    SERVO_DOWN = "servo_down"


RUNAWAY_FAULTS = ("overspeed", "energy", "force_at_limit")  # codes of `faults`


@dataclass(frozen=True, slots=True)
class TrialEnd:
    """An early end of a trial. `fault`: the code of the servo's fault, "" without one."""

    reason: EndReason
    text: str
    fault: str = ""

    def __str__(self) -> str:
        return f"{self.reason.replace('_', ' ')}: {self.text}"

    @property
    def ran_away(self) -> bool:
        """Whether the motion grew by itself, as the monitor or the servo saw."""
        return self.reason is EndReason.ESCAPE or self.fault in RUNAWAY_FAULTS


def end_of_plain(plain: Mapping[str, Any] | None) -> TrialEnd | None:
    """The end that `to_json` wrote. ValueError or KeyError for anything else."""
    return TrialEnd(EndReason(plain["reason"]), plain["text"], plain["fault"]) if plain else None


SUMMARY = "run.json"
RECORD_H5 = "record.h5"

IMPEDANCE = "impedance.csv"
FIGURE_KINDS = ("png", "svg", "pdf")  # the files of each figure
FIGURES = (
    "trial",
    "trial_admittance",
    "limits",
    "walls",
    "search",
    "set",
    "envelope",
    "envelope_admittance",
    "envelope_so_far",
)
OF_A_RUN = (
    SUMMARY,
    RECORD_H5,
    IMPEDANCE,
    *(f"{name}.{kind}" for name in FIGURES for kind in FIGURE_KINDS),
)
Progress = Callable[[str, int, int], None]  # of what is done, how many are done, and of how many
MARK_SAMPLE = "mark_sample"  # of the record, at which the mark of the perturbation begins
LossesBy = Literal["counter", "times", "nothing"]  # what shows that rows of a file are missing
LOSSES_BY = "losses_by"
# what the numbers of a record rest on
RESTS_ON = ("calibration_doubts", "certificate", LOSSES_BY)
OF_A_RECORD = (
    "simulated",
    "origin",
    "environment",
    "active_damping_ns_per_m",
    "ended",
    "max_command_n",
    "command_limit_n",
    "lost_samples",
    "samples",
    "lost_slots",
    "slots",
    MARK_SAMPLE,
    *RESTS_ON,
)


def silent(what: str, done: int, total: int) -> None:
    """Report nothing."""


class Steps:
    """Counts the steps of a procedure; reports before each, and once at the end."""

    def __init__(self, tell: Progress, total: int) -> None:
        self._tell = tell
        self._total = total
        self._done = 0

    def next(self, what: str) -> None:
        """The next step begins, and is `what`."""
        self._tell(what, min(self._done, self._total), self._total)
        self._done += 1

    def end(self) -> None:
        """All is done."""
        self._tell("done", self._total, self._total)


def to_json(value: Any, *, skip: tuple[str, ...] = ()) -> Any:
    """`value` as dicts, lists, strings and finite numbers; its own fields named in `skip` are
    left out.
    """
    return to_jsonable_python(
        value, exclude=set(skip) or None, inf_nan_mode="null", fallback=_listed
    )


def _listed(value: Any) -> Any:
    """What pydantic does not know: numbers and arrays of numpy; anything else in words."""
    if isinstance(value, np.ndarray) and value.dtype.kind == "c":
        return np.stack((value.real, value.imag), axis=-1).tolist()
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)


@dataclass(frozen=True, eq=False)
class TrialRecord:
    """`force_n`, `velocity_m_per_s` (N,) float64 at `rate_hz`. `ended`: why before its time,
    None if it was not.

    `max_command_n` is the largest force that was commanded, `command_limit_n` what the device can
    do; None where not known. `more`: what else the source says of itself, for the run's summary.
    `rendered`: what the record says that it was recorded in.
    """

    force_n: Floats
    velocity_m_per_s: Floats
    rate_hz: float
    origin: str
    simulated: bool
    ended: TrialEnd | None = None
    max_command_n: float | None = None
    command_limit_n: float | None = None
    more: Mapping[str, Any] = field(default_factory=dict)
    rendered: Environment | None = None

    @property
    def seconds(self) -> float:
        """Length."""
        return self.force_n.size / self.rate_hz


def too_short(seconds: float, ended: TrialEnd | None) -> AnalysisError:
    """The error for a trial that `ended` so after `seconds` and has no spectrum to judge."""
    what = f"ended after {seconds:.3g} s{f' ({ended})' if ended else ''}: too short for a verdict"
    if ended and ended.ran_away:
        return AnalysisError(
            f"{what}; an environment that runs away by itself is unstable: its limit is found from"
            " below, with a smaller K, B or M or more damping"
        )
    if ended and ended.reason is EndReason.SATURATION:
        return AnalysisError(f"{what}; take a weaker perturbation, or a smaller K, B or M")
    return AnalysisError(what)


def fingerprint(value: Any) -> str:
    """SHA-256 (hex) over the canonical JSON of `value`: equal for equal values."""
    return hashlib.sha256(
        json.dumps(to_json(value), sort_keys=True, separators=(",", ":")).encode()
    ).hexdigest()


def write_run(
    folder: Path,
    summary: Mapping[str, Any],
    recorded: TrialRecord | None = None,
    texts: Mapping[str, str] | None = None,
) -> Path:
    """A run folder, made if need be, in place of the run that was there; `texts`: further files by
    name.

    The summary is written last: a folder that has one has the rest. ConfigError if it cannot be
    written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in OF_A_RUN:
            (folder / name).unlink(missing_ok=True)
        if recorded is not None:
            _write_record(folder, recorded, json.dumps(to_json(origin_of(summary))))
        for name, content in (texts or {}).items():
            (folder / name).write_text(content)
        (folder / SUMMARY).write_text(json.dumps(to_json(summary), indent=1) + "\n")
    except OSError as error:
        raise not_writable(folder, error) from error
    return folder


def not_writable(path: Path, error: OSError) -> ConfigError:
    """The error for a file or folder of results that cannot be written to."""
    return ConfigError(f"{path}: {error.strerror}; name a folder that you may write to with --out")


def csv_text(columns: Mapping[str, Floats]) -> str:
    """Columns (n,) of numbers by their names as text; empty where a number is not finite."""
    rows = (
        ",".join(f"{value:.9g}" if np.isfinite(value) else "" for value in row)
        for row in np.column_stack([*columns.values()])
    )
    return "\n".join((",".join(columns), *rows, ""))


def read_summary(folder: Path) -> dict[str, Any]:
    """The summary of a run folder. ConfigError if it is none."""
    try:
        return dict(json.loads((folder / SUMMARY).read_text()))
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(
            f"{folder}: no run folder ({error}); a folder with {SUMMARY} was expected"
        ) from error


def origin_of(summary: Mapping[str, Any]) -> dict[str, Any]:
    """What a record says of itself, of its run's summary: where it comes from, what was
    rendered, why it ended, what was lost.
    """
    return {name: summary[name] for name in OF_A_RECORD if name in summary}


def record_path(folder: Path) -> Path:
    """The record of a run folder, to be read with `recorded.read_file`. ConfigError if it holds
    none.
    """
    path = folder / RECORD_H5
    if not path.is_file():
        raise ConfigError(f"{folder}: no record; {RECORD_H5} was expected")
    return path


def _write_record(folder: Path, recorded: TrialRecord, origin_json: str) -> None:
    import h5py

    packed = {"chunks": True, "shuffle": True, "compression": "gzip", "compression_opts": 1}
    with h5py.File(folder / RECORD_H5, "w") as file:
        file["rate_hz"] = recorded.rate_hz
        file["trial"] = origin_json
        for name in ("force_n", "velocity_m_per_s"):
            values = np.asarray(getattr(recorded, name), np.float32)
            file.create_dataset(name, data=values, **packed)


class TrialStore:
    """`known` outcomes by key; `add` appends. Without a path nothing is kept."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.known: dict[str, Mapping[str, Any]] = {} if path is None else dict(_read(path))

    def add(self, found: Iterable[tuple[str, Mapping[str, Any]]]) -> None:
        """Remember and write. ConfigError if the file cannot be written."""
        new = dict(found)
        if self._path is not None and new:
            try:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                with self._path.open("a") as file:
                    for key, outcome in new.items():
                        file.write(json.dumps({"key": key, **to_json(outcome)}) + "\n")
            except OSError as error:
                raise not_writable(self._path, error) from error
        self.known.update(new)


def _read(path: Path) -> Iterable[tuple[str, dict[str, Any]]]:
    try:
        if not path.exists():
            return
        if not path.is_file():
            raise ConfigError(f"{path}: no file; name a folder that you may write to with --out")
        content = path.read_bytes()
        if not content.endswith(
            b"\n"
        ):  # the run before died while writing: cut its line off, so that ours begins anew
            os.truncate(path, content.rfind(b"\n") + 1)
    except OSError as error:
        raise not_writable(path, error) from error
    for line in content.splitlines():
        try:
            outcome = json.loads(line)
            yield outcome.pop("key"), outcome
        except (ValueError, KeyError, AttributeError, TypeError):  # torn, or not ours
            continue
