"""Files of records: their sampling rate and missing samples, and the records of hapticd itself.

Times (`sampling`). A column of times gives the rate and the missing samples. The rate is that of
the step, not of the mean: missing rows lengthen the mean step, and every limit moves with the rate
or its square. With one row in a hundred missing a margin of +0.54 N s/m read -0.24. Each time is
therefore placed on the line

    t_i = t_0 + T n_i,    n_i whole numbers that grow by 1 or more

where 1/T is the rate at which the phases 2 pi t_i / T agree best, whichever rows are missing. A
stamp that is later than the following samples allow is jitter, not a loss: n_i - i never falls, and
is the number of samples lost before row i.

Seconds that were rounded to more than a period (milliseconds at 4 kHz) repeat. If each value
corresponds to a whole number of samples, values with fewer samples lost some; otherwise the times
give only the mean rate.

Counters (`counted`). A counter of samples grows by 1 with every sample, so a larger step is a loss.
It wraps at 2^48 at the latest, as a clock of 48 bits does: a step back of about that much is a step
forward.

Limitations: losses combined with jitter of half a period or more (the times are then uneven, and
refused); a counter of fewer bits that wraps within the record (refused too).

Records of hapticd (`of_recording`, `of_remark`). Each file becomes the record of one trial:

    NAME.h5, NAME.part.h5      a recording by `hapticd record`: the probe's samples and the ticks
    NAME.mat                   its export for MATLAB: the same as structures
    NAME.probe.csv             its export as text; the last line, a remark, summarises the ticks
    record.h5                  of a trial, with the details of `run.json` next to it or in the file

A recording is cut to its longest stretch that is one trial (`recording.pack`); the numbers of its
samples show which are missing. A mark of the perturbation precedes that stretch
(`excitation.marked`); its start is given in samples of the stretch, for `aligned`.

Columns must have the units of this package, which writes all of them.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import log10
from pathlib import Path
from typing import Any

import numpy as np

from hapticd.core.arrays import Floats, Integers
from hapticd.core.environment import Environment
from hapticd.core.errors import AnalysisError
from hapticd.core.units import PROBE_RATE_HZ, percent
from hapticd.recording.pack import JSON_ATTRIBUTES, REMARK_ATTRIBUTES, ReadColumn, Stretch, stretch
from hapticd.zwidth.alignment import find_marks
from hapticd.zwidth.store import MARK_SAMPLE, TrialRecord, to_json
from hapticd.zwidth.watch import in_even_time

GAP = 10.0  # periods between two rounded times; fewer are those of rounding
ROUNDED = 0.005  # share of steps of 0 from which on times count as rounded
SINGLE = (0.25, 1.75)  # usual steps: one period, whatever it was rounded to
EVEN = 0.3  # of 1: minimum coherence of the phases of the times
SHORT = 16  # samples of the first search for the rate
MOSTLY = 0.5  # share of rounded times that have all of their samples
MOST_MISSING = 0.1  # share of a record; with more it is not a record of one trial
SLOWEST_HZ = 20.0  # a slower record contains nothing about a display
USUAL_HZ = (100.0, 1e5)
REMEDY = (
    "sort the rows and remove duplicates, cut the record there, or give --rate-hz if it is complete"
)
BITS = 48  # of the longest counter
WRAP = 1 << BITS
MOST_LOST_AT_ONCE = 1 << 24  # samples, an hour
RIGHT_COUNTER = "name the right column with --counter, or leave that out"
SPARE_UNITS = (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))


@dataclass(frozen=True, eq=False)
class Sampling:
    """`rate_hz` of the clock; `place` (n,) of each row on it, from 0, None if rows simply follow
    each other. `shows_losses`: a missing row would be visible.
    """

    rate_hz: float
    place: Integers | None = None
    shows_losses: bool = True


def sampling(time_s: Floats) -> Sampling:
    """Return the sampling of rows at `time_s` (n,) [s], n > 1. AnalysisError for uneven times, or
    for another unit than seconds.
    """
    steps = np.diff(time_s)
    _forwards(time_s, steps)
    still = float(np.mean(steps == 0.0))
    found = _rounded(time_s, steps) if still > ROUNDED else _even(time_s, steps)
    if found.rate_hz < SLOWEST_HZ:
        digits = 3 + max(0, int(-log10(found.rate_hz)))
        raise AnalysisError(
            f"a sample rate of {found.rate_hz:.{digits}g} Hz, if it is in seconds;"
            f" {unit_hint(found.rate_hz)}"
        )
    return found


def unit_hint(rate_hz: float) -> str:
    """Describe the unit of time that would turn a rate that is far too slow into a display's; "" if
    none would.
    """
    for name, seconds in SPARE_UNITS:
        if USUAL_HZ[0] <= rate_hz / seconds <= USUAL_HZ[1]:
            return (
                f"it looks like {name}, of samples at {rate_hz / seconds:.6g} Hz: divide it by"
                f" {1.0 / seconds:g}"
            )
    return "seconds were expected"


def _forwards(time_s: Floats, steps: Floats) -> None:
    """Raise AnalysisError if times fall, or repeat without rounding."""
    back = np.flatnonzero(~(steps >= 0.0))
    if back.size:
        row = int(back[0])
        raise AnalysisError(
            f"sample {row + 2} at {time_s[row + 1]:.9g} s follows one at {time_s[row]:.9g} s;"
            f" {REMEDY}"
        )
    twice = np.flatnonzero(steps == 0.0)
    if 0 < twice.size <= ROUNDED * steps.size:
        row = int(twice[0])
        raise AnalysisError(
            f"{twice.size} samples have the time of the one before, the first is sample {row + 2}"
            f" at {time_s[row]:.9g} s; {REMEDY}"
        )


def _rounded(time_s: Floats, steps: Floats) -> Sampling:
    """Return the sampling of repeating times: whole numbers of samples to each, some of them
    missing, or otherwise the mean rate.
    """
    period_s = float(steps.mean())
    usual_s = float(np.median(steps[steps > 0.0])) if steps.any() else 0.0
    if not (period_s > 0.0 and steps.max() <= GAP * min(period_s, usual_s)):
        raise AnalysisError(_uneven(steps))
    first, counts = np.unique(time_s, return_index=True, return_counts=True)[1:]
    most = int(counts[1:-1].max(initial=0))
    if most < 2 or np.mean(counts[1:-1] == most) < MOSTLY:
        return Sampling(1.0 / period_s, shows_losses=False)
    rank = np.arange(time_s.size) - np.repeat(first, counts)
    rank[: counts[0]] += most - counts[0]
    place = most * np.rint((time_s - time_s[0]) / usual_s).astype(np.int64) + rank
    return _placed(most / usual_s, place - place[0], steps)


def _even(time_s: Floats, steps: Floats) -> Sampling:
    """Return rate and positions from the line through all times."""
    usual_s = float(np.median(steps))
    single = steps[(steps > SINGLE[0] * usual_s) & (steps < SINGLE[1] * usual_s)]
    time = time_s - time_s[0]
    rate_hz = _in_phase(time, 1.0 / float(single.mean()))
    phasor = complex(np.exp(2j * np.pi * rate_hz * time).mean())
    if abs(phasor) < EVEN:
        raise AnalysisError(_uneven(steps))
    place = _in_order(np.rint(rate_hz * time - np.angle(phasor) / (2.0 * np.pi)).astype(np.int64))
    return _placed(rate_hz, place - place[0], steps)


def _in_phase(time_s: Floats, rate_hz: float) -> float:
    """Return the rate near `rate_hz` at which all times have one phase, whichever of them are
    missing. It is found over short stretches first, where a slightly wrong rate turns the phase by
    less than half, then over longer ones.
    """
    length = SHORT
    while length < 2 * time_s.size:
        ends = np.arange(0, time_s.size, length)
        many = np.diff(np.append(ends, time_s.size))
        phase = np.add.reduceat(np.exp(2j * np.pi * rate_hz * time_s), ends)
        middle = np.add.reduceat(time_s, ends) / many
        if middle.size > 1:
            turned = float(np.angle(np.sum(phase[1:] * phase[:-1].conj())))
            rate_hz -= turned / (2.0 * np.pi * float(np.diff(middle).mean()))
        length *= 2
    return rate_hz


def _placed(rate_hz: float, place: Integers, steps: Floats) -> Sampling:
    total = int(place[-1]) + 1
    lost = total - place.size
    if lost > MOST_MISSING * total:
        raise AnalysisError(
            f"{lost} of {total} samples are missing, {percent(lost / total)}: {_uneven(steps)}"
        )
    return Sampling(rate_hz, place if lost else None)


def _in_order(place: Integers) -> Integers:
    """Return whole numbers that grow by 1 or more: a position too high for the following ones was a
    late stamp.
    """
    at = np.arange(place.size)
    return np.asarray(np.minimum.accumulate((place - at)[::-1])[::-1] + at)


def _uneven(steps: Floats) -> str:
    return (
        f"seconds do not run evenly, steps of {steps.min():.3g} to {steps.max():.3g} s; samples are"
        " missing or it is not a time: cut the record there, or give --rate-hz if it is complete"
    )


# --- counters of samples --------------------------------------------------------------------------


def counted(name: str, counts: Floats) -> tuple[Integers, int]:
    """Return positions (n,) from 0 from the counter of samples `name`, and its first number.
    AnalysisError for numbers that do not count samples.
    """
    _whole(name, counts)
    steps = np.mod(np.diff(counts.astype(np.int64)), WRAP)
    if steps.size and not _counts_samples(steps):
        raise AnalysisError(
            f"column {name} counts by {steps.min()} to {steps.max()}, median"
            f" {np.median(steps):g}; a number that grows by 1 with every sample was expected:"
            f" {RIGHT_COUNTER}"
        )
    return np.concatenate(([0], np.cumsum(steps))), int(counts[0])


def _whole(name: str, counts: Floats) -> None:
    """Raise AnalysisError for values other than whole numbers of BITS bits."""
    good = (counts >= 0.0) & (counts < WRAP) & (counts == np.rint(counts))
    if not good.all():
        row = int(np.argmin(good))
        raise AnalysisError(
            f"column {name}: {counts[row]:.9g} at sample {row + 1}; a whole number from 0 to"
            f" 2^{BITS} - 1 was expected: {RIGHT_COUNTER}"
        )


def _counts_samples(steps: Integers) -> bool:
    """Whether `steps` of a counter are 1, but for plausible losses."""
    least, most = int(steps.min()), int(steps.max())
    return least >= 1 and most <= MOST_LOST_AT_ONCE and float(np.median(steps)) == 1.0


def unwrapped(times: Floats) -> Floats:
    """Return `times` (n,) of a clock, in its own unit, unwrapped at 2^48; any other fall does not
    change.
    """
    back = np.flatnonzero(np.diff(times) < 0.0)
    if back.size != 1 or times[back[0] + 1] - times[back[0]] > -WRAP / 2:
        return times
    return np.where(np.arange(times.size) > back[0], times + WRAP, times)


# --- records of hapticd ---------------------------------------------------------------------------
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
