"""The verdicts of hapticd on a folder of trials, from the npz files alone.

The files are read like those of any other program (`hapticd zwidth import`). The device is unknown,
so nothing is predicted, and the loop is judged unstable only if the record shows it. Band and
confidence are those of the verbs, 2 to 500 Hz and 95 %.

A record that hapticd refuses to judge is undecided, without a margin.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from examples.trials.files import FORCE, METADATA, VELOCITY
from examples.trials.score import COLUMNS, GivenVerdict
from hapticd.core.errors import AnalysisError, ConfigError
from hapticd.zwidth.recorded import read_file
from hapticd.zwidth.sources import Trial, file_source
from hapticd.zwidth.store import Progress, Steps, silent
from hapticd.zwidth.trial import TrialParams, plan_trial, run_trial

__all__ = ["judge", "verdicts_csv"]


def judge(folder: Path, tell: Progress = silent) -> list[GivenVerdict]:
    """Return a verdict on each trial of the folder, in the order of their names. ConfigError if a
    file is missing or broken.
    """
    paths = sorted(folder.glob("*.npz"))
    if not paths:
        raise ConfigError(
            f"{folder}: no trial (*.npz); make them with `python -m examples.trials make --out"
            f" {folder}`"
        )
    steps = Steps(tell, len(paths))
    found = []
    for path in paths:
        steps.next(path.stem)
        found.append(verdict_of(path))
    steps.end()
    return found


def verdict_of(path: Path) -> GivenVerdict:
    """Return the verdict on one file."""
    record = read_file(path, force=FORCE, velocity=VELOCITY)
    stiffness, virtual_damping, mass, level = metadata_of(path)
    trial = Trial((stiffness, virtual_damping, mass), level, record.seconds)
    try:
        found = run_trial(plan_trial(TrialParams(trial)), file_source(record)).verdict
    except AnalysisError:
        return GivenVerdict(path.stem, "undecided")
    margin = found.margin_ns_per_m
    return GivenVerdict(path.stem, found.answer, margin.value, margin.lower, margin.upper)


def metadata_of(path: Path) -> list[float]:
    """Return K [N/m], B [N s/m], M [kg] and active damping [N s/m] of a file; else ConfigError."""
    try:
        with np.load(path) as arrays:
            return [float(arrays[name]) for name in METADATA[1:]]
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(
            f"{path}: {error}; one number each of {', '.join(METADATA[1:])} was expected"
        ) from error


def verdicts_csv(given: Iterable[GivenVerdict]) -> str:
    """Return the verdicts in the format of `score`."""
    lines = [",".join(COLUMNS)]
    for one in given:
        numbers = (one.margin_ns_per_m, one.low_ns_per_m, one.high_ns_per_m)
        cells = ("" if number is None else f"{number:.5g}" for number in numbers)
        lines.append(",".join((one.trial, one.verdict, *cells)))
    return "\n".join((*lines, ""))
