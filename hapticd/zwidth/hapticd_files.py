"""Reads records that hapticd itself wrote. Each becomes the record of one trial:

    NAME.h5, NAME.part.h5      a recording by `hapticd record`: the probe's samples and the ticks
    NAME.mat                   its export for MATLAB: the same as structures
    NAME.probe.csv             its export as text; the last line, a remark, summarises the ticks
    record.h5                  of a trial, with the details of `run.json` next to it or in the file

A recording is cut to its longest stretch that is one trial (`recording.pack`); the numbers of
its samples show which are missing. A mark of the perturbation precedes that stretch
(`excitation.marked`); its start is given in samples of the stretch, for `aligned`.

Columns must have the units of this package, which writes all of them.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hapticd.core.arrays import Integers
from hapticd.core.environment import Environment
from hapticd.core.errors import AnalysisError
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.recording.pack import JSON_ATTRIBUTES, REMARK_ATTRIBUTES, ReadColumn, Stretch, stretch
from hapticd.signal.alignment import find_marks
from hapticd.zwidth.store import MARK_SAMPLE, TrialRecord, to_json
from hapticd.zwidth.watch import in_even_time

BEFORE = 2 * PROBE_RATE_HZ  # samples before a trial that are searched for its mark


def of_recording(column: ReadColumn, attributes: Mapping[str, Any], name: str) -> TrialRecord:
    """Return the trial in a recording called `name`. AnalysisError without probe samples."""
    return _cut(column, attributes, stretch(column, attributes, name), name)


def of_remark(column: ReadColumn, remark: Mapping[str, Any], name: str) -> TrialRecord:
    """Return the trial in a text file `name` that ends with `remark`. AnalysisError for the table
    of the servo.
    """
    if "trial" not in remark:
        raise AnalysisError(
            f"{name}: a table of the servo's ticks; the probe's samples are in"
            f" {Path(name).stem}.probe.csv"
        )
    stated = {**remark["trial"], "environment": tuple(remark["trial"]["environment"])}
    return _cut(column, remark, Stretch(**stated), name)


def _cut(
    column: ReadColumn, attributes: Mapping[str, Any], trial: Stretch, name: str
) -> TrialRecord:
    part = slice(trial.first, trial.after)
    force, velocity = (
        np.asarray(column("probe", one), np.float64)[part]
        for one in ("torque_n", "velocity_m_per_s")
    )
    more = {
        one: json.loads(attributes[one]) if one in JSON_ATTRIBUTES else to_json(attributes[one])
        for one in REMARK_ATTRIBUTES
        if attributes.get(one) not in (None, "")
    }
    index = np.asarray(column("probe", "index"), np.int64)
    recorded = TrialRecord(
        force,
        velocity,
        float(PROBE_RATE_HZ),
        f"recording {name} of {attributes.get('device_name', 'a device')!s}, {trial.begin_s:.4g} to"
        f" {trial.end_s:.4g} s",
        bool(int(attributes["simulated"])),
        max_command_n=trial.max_command_n,
        command_limit_n=trial.command_limit_n,
        more={
            **more,
            "lost_slots": trial.lost_slots,
            "slots": trial.slots,
            **_mark(column, trial.first, index),
        },
        rendered=Environment(
            *trial.environment, active_damping_ns_per_m=trial.active_damping_ns_per_m
        ),
    )
    return in_even_time(recorded, index[part])


def _mark(column: ReadColumn, first: int, index: Integers) -> dict[str, int]:
    """Return the start of the last mark before row `first`, relative to it; {} without one."""
    begin = max(0, first - BEFORE)
    marks = find_marks(np.asarray(column("probe", "torque_n"), np.float64)[begin:first])
    return {MARK_SAMPLE: int(index[begin + marks[-1].row] - index[first])} if marks else {}
