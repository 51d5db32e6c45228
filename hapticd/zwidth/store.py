"""The files of a procedure, and the report of its progress.

Results are stored in a folder for each run, and in an append-only file of trials from which an
interrupted map or limit continues:

    run folder     run.json (verdict, conditions, provenance); of a trial record.h5 and
                   impedance.csv; figures
    trial store    one JSON object a line, keyed by the SHA-256 of everything that the trial's
                   outcome depends on

A line is written at once and flushed, so that Ctrl-C or a crash loses at most the trials in flight;
an incomplete last line is ignored. A run folder holds one run. Writing another run there removes
the files of the previous one, but not the store, which several runs share, and not files of other
names. JSON has no nan and no infinity: both become null, and null is read as nan.

Results become JSON-compatible objects (`plain`): arrays become lists, complex numbers pairs, values
that are not finite null.

Limitations: two processes that append to one store at the same time; their lines may interleave,
and such lines are ignored.
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
    "fingerprint",
    "read_summary",
    "silent",
    "to_json",
    "write_run",
]

# --- the end of a trial ---------------------------------------------------------------------------


class EndReason(StrEnum):
    """The reason for an early end of a trial, as in run.json. It and the code of the fault
    determine the verdict, a further trial, and the exit code.
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
        """Whether the motion grew by itself, as seen by the monitor or the servo."""
        return self.reason is EndReason.ESCAPE or self.fault in RUNAWAY_FAULTS


def end_of_plain(plain: Mapping[str, Any] | None) -> TrialEnd | None:
    """Return the end that `to_json` wrote. ValueError or KeyError for anything else."""
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
Progress = Callable[[str, int, int], None]  # name of the step, number of completed steps, total
MARK_SAMPLE = "mark_sample"  # of the record, at which the mark of the perturbation begins
LossesBy = Literal["counter", "times", "nothing"]  # evidence of missing rows of a file
LOSSES_BY = "losses_by"
# the basis of a record's numbers
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
    """Count the steps of a procedure; report before each, and once at the end."""

    def __init__(self, tell: Progress, total: int) -> None:
        self._tell = tell
        self._total = total
        self._done = 0

    def next(self, what: str) -> None:
        """Begin the next step, `what`."""
        self._tell(what, min(self._done, self._total), self._total)
        self._done += 1

    def end(self) -> None:
        """Report the end."""
        self._tell("done", self._total, self._total)


def to_json(value: Any, *, skip: tuple[str, ...] = ()) -> Any:
    """Return `value` as dicts, lists, strings and finite numbers, without its fields in `skip`."""
    return to_jsonable_python(
        value, exclude=set(skip) or None, inf_nan_mode="null", fallback=_listed
    )


def _listed(value: Any) -> Any:
    """Convert types unknown to pydantic: numbers and arrays of numpy; anything else to a string."""
    if isinstance(value, np.ndarray) and value.dtype.kind == "c":
        return np.stack((value.real, value.imag), axis=-1).tolist()
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)


@dataclass(frozen=True, eq=False)
class TrialRecord:
    """`force_n`, `velocity_m_per_s` (N,) float64 at `rate_hz`. `ended`: reason for an early end,
    otherwise None.

    `max_command_n` is the largest commanded force, `command_limit_n` the device's limit; None if
    unknown. `more`: further information of the source, for the run's summary. `rendered`: the
    environment stored in the record.
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
    """Return the error for a trial that `ended` after `seconds` and has no spectrum to judge."""
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
    """Return the SHA-256 (hex) of the canonical JSON of `value`: equal for equal values."""
    return hashlib.sha256(
        json.dumps(to_json(value), sort_keys=True, separators=(",", ":")).encode()
    ).hexdigest()


def write_run(
    folder: Path,
    summary: Mapping[str, Any],
    recorded: TrialRecord | None = None,
    texts: Mapping[str, str] | None = None,
) -> Path:
    """Write a run folder, created if necessary, in place of the previous run; `texts`: further
    files by name.

    The summary is written last: a folder with a summary is complete. ConfigError if it cannot be
    written.
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
    """Return the error for a file or folder of results that cannot be written."""
    return ConfigError(f"{path}: {error.strerror}; name a folder that you may write to with --out")


def csv_text(columns: Mapping[str, Floats]) -> str:
    """Return columns (n,) of numbers, by name, as text; empty for a number that is not finite."""
    rows = (
        ",".join(f"{value:.9g}" if np.isfinite(value) else "" for value in row)
        for row in np.column_stack([*columns.values()])
    )
    return "\n".join((",".join(columns), *rows, ""))


def read_summary(folder: Path) -> dict[str, Any]:
    """Return the summary of a run folder. ConfigError if there is none."""
    try:
        return dict(json.loads((folder / SUMMARY).read_text()))
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(
            f"{folder}: no run folder ({error}); a folder with {SUMMARY} was expected"
        ) from error


def origin_of(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of a run's summary that its record contains: origin, environment, reason of
    the end, losses.
    """
    return {name: summary[name] for name in OF_A_RECORD if name in summary}


def record_path(folder: Path) -> Path:
    """Return the record of a run folder, for `recorded.read_file`. ConfigError if there is none."""
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
    """`known` outcomes by key; `add` appends. Without a path nothing is stored."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.known: dict[str, Mapping[str, Any]] = {} if path is None else dict(_read(path))

    def add(self, found: Iterable[tuple[str, Mapping[str, Any]]]) -> None:
        """Store new outcomes. ConfigError if the file cannot be written."""
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
        ):  # the previous run died while writing: remove its incomplete line
            os.truncate(path, content.rfind(b"\n") + 1)
    except OSError as error:
        raise not_writable(path, error) from error
    for line in content.splitlines():
        try:
            outcome = json.loads(line)
            yield outcome.pop("key"), outcome
        except (ValueError, KeyError, AttributeError, TypeError):  # incomplete or foreign
            continue
