"""Comparison of any estimator's verdicts with the truth.

A verdict is passive, not_passive or undecided. An unstable display is not passive, so not_passive
is the right answer there. There are four outcomes:

    correct               passive or not passive, as in the truth
    wrongly passive       the dangerous one: some hand makes that display unstable
    wrongly not passive   a display that could have been rendered is given away
    undecided             no answer

A margin is the minimum Re Z over the band [N s/m]. For stable trials with a margin, the error is
the given margin minus the truth. An interval covers if the truth lies in it.

The band of the truth must be the judged one.
"""

import csv
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import isfinite, nan
from pathlib import Path
from statistics import fmean
from typing import Any

from hapticd.core.errors import ConfigError
from hapticd.settings.toml import SETTINGS_BYTES, regular
from hapticd.zwidth.report.paper import Table, table

__all__ = [
    "COLUMNS",
    "GivenVerdict",
    "Score",
    "TrueAnswer",
    "read_truth",
    "read_verdicts",
    "score",
    "score_json",
    "score_table",
]

COLUMNS = ("trial", "verdict", "margin_n_s_per_m", "margin_low_n_s_per_m", "margin_high_n_s_per_m")
VERDICTS = ("passive", "not_passive", "undecided")
TRUTHS = ("passive", "not_passive", "unstable")
OUTCOMES = ("correct", "wrongly_passive", "wrongly_not_passive", "undecided")
HEADINGS = (
    "trials",
    "number",
    "correct",
    "wrongly passive",
    "wrongly not passive",
    "undecided",
    "margin bias [N s/m]",
    "margin error, rms [N s/m]",
    "intervals that cover",
)


@dataclass(frozen=True)
class GivenVerdict:
    """Verdict of an estimator on a trial: margin and interval [N s/m], None if not given; `where`:
    its file and line.
    """

    trial: str
    verdict: str
    margin_ns_per_m: float | None = None
    low_ns_per_m: float | None = None
    high_ns_per_m: float | None = None
    where: str = ""


@dataclass(frozen=True)
class TrueAnswer:
    """Truth of a trial: one of TRUTHS; the margin [N s/m], None if it is unstable."""

    truth: str
    margin_ns_per_m: float | None
    near_edge: bool


@dataclass(frozen=True)
class Judgement:
    """One trial: the given verdict and the truth."""

    given: GivenVerdict
    true: TrueAnswer

    @property
    def outcome(self) -> str:
        """One of OUTCOMES."""
        if self.given.verdict == "undecided":
            return "undecided"
        said, right = self.given.verdict == "passive", self.true.truth == "passive"
        if said == right:
            return "correct"
        return "wrongly_passive" if said else "wrongly_not_passive"

    @property
    def error_ns_per_m(self) -> float | None:
        """Error of the margin, None without one."""
        given, true = self.given.margin_ns_per_m, self.true.margin_ns_per_m
        return None if given is None or true is None else given - true

    @property
    def covers(self) -> bool | None:
        """Whether the interval contains the true margin, None without one of them."""
        low, high, true = (
            self.given.low_ns_per_m,
            self.given.high_ns_per_m,
            self.true.margin_ns_per_m,
        )
        return None if low is None or high is None or true is None else low <= true <= high


@dataclass(frozen=True)
class Score:
    """Score of an estimator in a group of trials; nan if no margin was given [N s/m]."""

    trials: str
    number: int
    counts: dict[str, int]
    bias_ns_per_m: float
    rms_error_ns_per_m: float
    intervals: int
    covered: int


# --- reading --------------------------------------------------------------------------------------


def read_truth(path: Path) -> dict[str, TrueAnswer]:
    """Read the truth by the names of trials. ConfigError for an invalid file."""
    try:
        content = json.loads(regular(path, SETTINGS_BYTES).read_text())
        found = {name: true_answer(one) for name, one in content["trials"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(
            f"{path}: no truth of trials ({error!r}); name the truth.json that `python -m"
            " examples.trials make` wrote"
        ) from error
    return found


def true_answer(kept: Mapping[str, Any]) -> TrueAnswer:
    """Parse one entry. KeyError or ValueError if it is incomplete."""
    if kept["truth"] not in TRUTHS:
        raise ValueError(f"truth {kept['truth']!r}: one of {', '.join(TRUTHS)} was expected")
    margin = kept["margin_n_s_per_m"]
    return TrueAnswer(
        kept["truth"], None if margin is None else float(margin), bool(kept["near_edge"])
    )


def read_verdicts(path: Path) -> list[GivenVerdict]:
    """Read the verdicts in a CSV file with a header line of COLUMNS, of which the margins may be
    omitted. ConfigError, with the line, for an invalid verdict or number.
    """
    try:
        lines = regular(path, SETTINGS_BYTES).read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: {error}; a CSV file of verdicts was expected") from error
    names = [name.strip() for name in next(csv.reader(lines), [])]
    check_columns(path, names)
    return [
        given_verdict(f"{path}:{number}", cells_of(f"{path}:{number}", names, line))
        for number, line in enumerate(lines[1:], 2)
        if line.strip() and not line.startswith("#")
    ]


def check_columns(path: Path, names: list[str]) -> None:
    """Raise ConfigError for a header line with missing or unknown columns."""
    missing = [name for name in COLUMNS[:2] if name not in names]
    unknown = [name for name in names if name not in COLUMNS]
    if missing or unknown:
        wrong = f"no column {missing[0]!r}" if missing else f"unknown column {unknown[0]!r}"
        raise ConfigError(
            f"{path}:1: {wrong}; write a header line of {','.join(COLUMNS)}, of which the margins"
            " may be left out"
        )


def cells_of(where: str, names: list[str], line: str) -> dict[str, str]:
    """Return a line by the names of its columns; ConfigError for more or fewer cells than names."""
    cells = [cell.strip() for cell in next(csv.reader([line]))]
    if len(cells) != len(names):
        raise ConfigError(
            f"{where}: {len(cells)} cells, the header line has {len(names)}; write one for each,"
            " empty where there is no number"
        )
    return dict(zip(names, cells, strict=True))


def given_verdict(where: str, cells: Mapping[str, str]) -> GivenVerdict:
    """Parse one line."""
    if cells["verdict"] not in VERDICTS:
        raise ConfigError(
            f"{where}: verdict {cells['verdict']!r}; write one of {', '.join(VERDICTS)}; what is"
            " unstable is not_passive"
        )
    margin, low, high = (number(where, name, cells.get(name, "")) for name in COLUMNS[2:])
    if (low is None) != (high is None):
        raise ConfigError(f"{where}: one limit of an interval; give both, or leave both empty")
    if low is not None and high is not None and low > high:
        raise ConfigError(
            f"{where}: {COLUMNS[3]} {low:g} is above {COLUMNS[4]} {high:g} N s/m; exchange them"
        )
    return GivenVerdict(cells["trial"], cells["verdict"], margin, low, high, where)


def number(where: str, name: str, text: str) -> float | None:
    """Parse a number, None for an empty cell. ConfigError for anything else."""
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        value = nan
    if not isfinite(value):
        raise ConfigError(
            f"{where}: {name} {text!r} is not a finite number; write it in N s/m with a decimal"
            " point, or leave the cell empty"
        )
    return value


# --- scoring --------------------------------------------------------------------------------------


def score(given: Iterable[GivenVerdict], truth: Mapping[str, TrueAnswer]) -> list[Judgement]:
    """Pair each trial of the truth with its verdict. ConfigError for a trial that is unknown,
    missing or judged twice.
    """
    said: dict[str, GivenVerdict] = {}
    for one in given:
        if one.trial not in truth:
            raise ConfigError(
                f"{one.where}: trial {one.trial!r}: no such trial; the truth has {', '.join(truth)}"
            )
        if one.trial in said:
            raise ConfigError(
                f"{one.where}: a second verdict on {one.trial}, the first is in"
                f" {said[one.trial].where}; leave one of them out"
            )
        said[one.trial] = one
    if missing := [name for name in truth if name not in said]:
        raise ConfigError(
            f"no verdict on {', '.join(missing)}: {len(said)} of {len(truth)} trials are judged;"
            " write undecided where there is no answer"
        )
    return [Judgement(said[name], true) for name, true in truth.items()]


def groups(judged: list[Judgement]) -> list[Score]:
    """Return the scores of all trials, and of each kind."""
    clear = [one for one in judged if not one.true.near_edge]
    kinds = {
        "clearly passive": [one for one in clear if one.true.truth == "passive"],
        "clearly not passive": [one for one in clear if one.true.truth == "not_passive"],
        "unstable": [one for one in clear if one.true.truth == "unstable"],
        "near the edge": [one for one in judged if one.true.near_edge],
        "all": judged,
    }
    return [scored(name, some) for name, some in kinds.items() if some]


def scored(name: str, judged: list[Judgement]) -> Score:
    """Return the score of some trials."""
    outcomes = [one.outcome for one in judged]
    errors = [one.error_ns_per_m for one in judged if one.error_ns_per_m is not None]
    covers = [one.covers for one in judged if one.covers is not None]
    return Score(
        name,
        len(judged),
        {outcome: outcomes.count(outcome) for outcome in OUTCOMES},
        fmean(errors) if errors else nan,
        fmean(error * error for error in errors) ** 0.5 if errors else nan,
        len(covers),
        sum(covers),
    )


def score_table(judged: list[Judgement]) -> Table:
    """Return a line for each group of trials."""
    return table(
        HEADINGS,
        [
            (
                one.trials,
                one.number,
                *one.counts.values(),
                one.bias_ns_per_m,
                one.rms_error_ns_per_m,
                f"{one.covered} of {one.intervals}" if one.intervals else "-",
            )
            for one in groups(judged)
        ],
    )


def score_json(judged: list[Judgement]) -> dict[str, Any]:
    """Return scores by group and single trials; None for a missing number."""
    return {
        "groups": [
            {
                "trials": one.trials,
                "number": one.number,
                **one.counts,
                "margin_bias_n_s_per_m": plain(one.bias_ns_per_m),
                "margin_rms_error_n_s_per_m": plain(one.rms_error_ns_per_m),
                "intervals": one.intervals,
                "intervals_that_cover": one.covered,
            }
            for one in groups(judged)
        ],
        "trials": [
            {
                "trial": one.given.trial,
                "truth": one.true.truth,
                "verdict": one.given.verdict,
                "outcome": one.outcome,
                "margin_error_n_s_per_m": one.error_ns_per_m,
                "covers": one.covers,
            }
            for one in judged
        ],
    }


def plain(value: float) -> float | None:
    """Return None for nan."""
    return value if isfinite(value) else None
