"""The part of a recording that is one trial, and the remark that stores it in a text file.

A recording is longer than a trial. The trial is its longest stretch in which the servo was enabled,
the probe perturbed the device (if it ever did) and nothing was changed. The ticks give the rendered
environment, the largest command, and the lost slots. The second in which the device settles after
the start of the perturbation is left out, as in a live trial.

An exported text file has no attributes. Its last line, the remark, contains its origin and, for the
probe's samples, which part is the trial.

Limitations: a recording whose board restarted in the middle; another servo life then begins, which
ends the stretch.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hapticd.core.arrays import Flags
from hapticd.core.errors import AnalysisError, ConfigError
from hapticd.core.units import NS_PER_S
from hapticd.mailbox.layout import LOST_SLOTS, State
from hapticd.recording.provenance import SCHEMA

__all__ = [
    "JSON_ATTRIBUTES",
    "PROBE_COLUMNS",
    "REMARK_ATTRIBUTES",
    "SERVO_COLUMNS",
    "ReadColumn",
    "Stretch",
    "read_remark",
    "stretch",
]

SETTLE_S = 1.0  # left out after the perturbation began
REMARK = f"# {SCHEMA} "
TAIL_BYTES = 8192  # at the end of a text file that contain the remark
SERVO_COLUMNS = {"tick", "revision", "force_n"}  # columns of a table of ticks
PROBE_COLUMNS = {"index", "torque", "velocity", "time_ns"}  # columns of a table of probe samples
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
