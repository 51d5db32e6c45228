"""Alignment of another acquisition system's record with the daemon's: its start, clock and gaps.

Both systems record the same force r(i). The other one has its own clock, so sample i is in row

    x(i) = c + (1 + e) i + k(i)

of its file. c is the offset, e the difference of the clocks. k is a whole number, because a file
loses whole samples: a gap of s samples lowers k by s.

mark        The mark at the start of the perturbation (`model.excitation`) gives c. It is a sequence
            of 1023 signs that correlates only with itself. With noise as strong as the force its
            coefficient is 0.7; anything else reaches 0.16 once in a million samples. A negative
            coefficient is an inverted sign.
pieces      After the mark, the perturbation itself is matched. Each quarter of a second of r is
            searched for from the row of the last match to the row expected now, so the search
            crosses a gap of any size. The peak of the correlation between the samples gives the
            fraction of a sample (`matching`).
clock       exp(2 pi j (x - i)) does not depend on k. Its phase from piece to piece gives e with all
            gaps still in the record. The remaining whole numbers are k. A line through the rest,
            with bisquare weights, gives c and e.
gaps        are where k changes (`matching`).

Limitations: a perturbation that repeats within a few seconds; a clock that wanders by half a sample
over the record (refused, because the pieces disagree). A gap in the first or last eighth of a
second is not found, so the record is aligned without them.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Floats, Integers
from hapticd.core.errors import AnalysisError
from hapticd.model.excitation import mark_signs
from hapticd.signal.channels import bisquare_fit
from hapticd.zwidth.matching import Gap, coefficients, find_gaps, fraction

__all__ = ["FASTEST", "LEAST", "NO_MARK", "Mark", "Track", "align", "find_marks"]

PIECE = 1024  # samples per piece
LEAST = 0.25  # minimum coefficient of a match: eight standard deviations of chance
FEWEST = 8  # minimum number of pieces for a clock
FASTEST = 1e-3  # maximum relative difference of two clocks; more is another rate
AGREED = 0.25  # maximum distance in samples from the line of a piece that agrees with it
MOSTLY = 0.5  # minimum share of pieces found
STEADY = 0.8  # minimum share of those that agree: a wandering clock spreads them evenly
MARKS = 16  # maximum number of marks examined in a file

NO_MARK = "start the other system before the trial, and run the trial with --mark"


@dataclass(frozen=True, slots=True)
class Mark:
    """Position of a mark and how well it fits (1: perfectly, negative: inverted)."""

    row: int  # of its first sample
    coefficient: float


@dataclass(frozen=True, slots=True)
class Clock:
    """The line x = offset + (1 + ppm 1e-6) i through the pieces."""

    offset_rows: float  # row of the own sample 0
    ppm: float  # how fast the file's clock runs
    ppm_sd: float  # standard deviation of it
    residual_samples: float  # rms of the pieces about the line

    def at(self, own_samples: Integers) -> Floats:
        """Return rows (n,) at samples (n,) of the own record, if nothing is lost."""
        return np.asarray(self.offset_rows + (1.0 + 1e-6 * self.ppm) * own_samples, np.float64)


@dataclass(frozen=True, eq=False)
class Track:
    """Position of each row on the clock of the file, gaps counted, and that clock relative to the
    daemon's.
    """

    mark: Mark
    clock: Clock
    gaps: tuple[Gap, ...]
    rows: Integers  # (n,) rows of the record
    place: Integers  # (n,) of each on the file's clock
    first: int  # own sample from which on the record is aligned
    after: int  # own sample after the last


def find_marks(force: npt.ArrayLike) -> tuple[Mark, ...]:
    """Return the marks in a signal (n,) of any unit at 4 kHz, in order; empty if there are none."""
    coefficient = coefficients(mark_signs(), np.asarray(force, np.float64))
    found: list[Mark] = []
    while len(found) < MARKS and coefficient.size:
        row = int(np.argmax(np.abs(coefficient)))
        if abs(coefficient[row]) < LEAST:
            break
        found.append(Mark(row, float(coefficient[row])))
        coefficient[max(0, row - PIECE) : row + PIECE] = 0.0
    return tuple(sorted(found, key=lambda mark: mark.row))


def align(own_n: npt.ArrayLike, mark_at: int, force: npt.ArrayLike) -> Track:
    """Align `force` (rows,), of any unit and either sign, with the daemon's own force `own_n` (n,)
    [N]; both at 4 kHz. The mark began at the own sample `mark_at`, before the record if negative.

    AnalysisError for a file without the mark, of another trial, or of another rate; for a record of
    fewer than 8 pieces.
    """
    own = np.asarray(own_n, np.float64)
    other = np.asarray(force, np.float64)
    other = other - other.mean() if other.size else other
    if own.size < FEWEST * PIECE:
        raise AnalysisError(
            f"a record of {own.size} samples cannot be aligned, {FEWEST * PIECE} are needed; make"
            " the trial longer"
        )
    mark = _mark_of(own, mark_at, other)
    other = np.copysign(1.0, mark.coefficient) * other
    lag = _lags(own, other, mark.row - mark_at)
    found = np.flatnonzero(np.isfinite(lag))
    clock, steps = _clock(lag, found)
    return _tracked(own, other, found, (mark, clock), steps)


# --- position of the record -----------------------------------------------------------------------


def _mark_of(own: Floats, mark_at: int, other: Floats) -> Mark:
    """Return the mark that the own record follows."""
    marks = find_marks(other)
    if not marks:
        best = float(np.abs(coefficients(mark_signs(), other)).max(initial=0.0))
        raise AnalysisError(
            f"no mark found: looked for {mark_signs().size} pseudo-random signs at 4 kHz in"
            f" {other.size} samples of force, the best coefficient is {best:.2g}, {LEAST:g} is"
            f" needed; {NO_MARK}, or name the force with --force-column"
        )
    scores = [_follows(own, other, mark, mark_at) for mark in marks]
    best_of = int(np.argmax(scores))
    if scores[best_of] < LEAST:
        raise AnalysisError(
            f"a mark at row {marks[best_of].row}, but the signal after it is not this trial: the"
            f" best coefficient of its first {FEWEST} pieces is {scores[best_of]:.2g}, {LEAST:g} is"
            " needed; name the daemon's record of the same trial with --align"
        )
    return marks[best_of]


def _follows(own: Floats, other: Floats, mark: Mark, mark_at: int) -> float:
    """Return how well the first pieces of the own record match after `mark`."""
    sign = np.copysign(1.0, mark.coefficient)
    found = []
    for first in range(0, FEWEST * PIECE, PIECE):
        row = mark.row - mark_at + first
        near = sign * other[max(0, row - PIECE) : max(0, row + 2 * PIECE)]
        found.append(coefficients(own[first : first + PIECE], near).max(initial=0.0))
    return float(np.max(found))


def _lags(own: Floats, other: Floats, start: int) -> Floats:
    """Return row in `other` minus own sample (n,) of each whole piece of the own record; nan if not
    found. Each search starts from the row of the last match. `start` is the row of own sample 0
    according to the mark.
    """
    lag = np.full(own.size // PIECE, np.nan)
    expected = start  # rows minus own samples
    lowest = max(0, start - PIECE)
    for number in range(lag.size):
        piece = own[number * PIECE : (number + 1) * PIECE]
        row = _found(piece, other, lowest, expected + (number + 2) * PIECE)
        if row is None:
            continue
        expected = row - number * PIECE
        lowest = row
        lag[number] = expected + fraction(piece, other[row : row + PIECE])
    return lag


def _found(piece: Floats, other: Floats, lowest: int, highest: int) -> int | None:
    """Return the row in `lowest` .. `highest` - 1 at which `piece` begins; None if not found."""
    coefficient = coefficients(piece, other[lowest : highest + PIECE])
    if not coefficient.size:
        return None
    best = int(np.argmax(coefficient))
    return lowest + best if coefficient[best] >= LEAST else None


# --- clock ----------------------------------------------------------------------------------------


def _clock(lags: Floats, known: Integers) -> tuple[Clock, Integers]:
    """Return the clock, and k (n,), from 0, of the pieces that were found, those `known` (n,)."""
    share = known.size / lags.size
    if known.size < FEWEST or share < MOSTLY:
        raise AnalysisError(
            f"{known.size} of {lags.size} pieces of the record were found in the file,"
            f" {100.0 * MOSTLY:g} % are needed: it ends too early, lost too much, or is too noisy;"
            " record the trial again"
        )
    middle = np.asarray(PIECE * known + 0.5 * (PIECE - 1), np.float64)
    lag = lags[known]
    rate = _rate(lags)
    phase = float(np.angle(np.exp(2j * np.pi * (lag - rate * middle)).sum())) / (2.0 * np.pi)
    steps = _settled(np.rint(lag - rate * middle - phase).astype(np.int64))
    steps -= steps[0]
    return _line(middle, lag - steps), steps


def _rate(lag: Floats) -> float:
    """Return the difference of the clocks from the lags of neighbours. All of them give its
    fraction of a sample, whatever was lost; most of them give the whole samples, usually 0.
    """
    steps = np.diff(lag)
    steps = steps[np.isfinite(steps)]
    turned = np.exp(2j * np.pi * steps).sum() if steps.size else 1.0
    part = float(np.angle(turned)) / (2.0 * np.pi)
    whole, often = np.unique(np.rint(steps - part), return_counts=True)
    rate = (part + float(whole[np.argmax(often)] if steps.size else 0.0)) / PIECE
    if not abs(rate) <= FASTEST:
        raise AnalysisError(
            f"the file's clock differs by {1e6 * rate:.4g} ppm, at most {1e6 * FASTEST:g} are"
            " aligned: it was recorded at another rate than 4 kHz, or loses samples all the time;"
            " record at 4 kHz without losses"
        )
    return rate


def _settled(steps: Integers) -> Integers:
    """Remove isolated values from whole numbers (n,) with a median of three."""
    if steps.size < 3:
        return steps
    three = np.sort(np.stack((steps[:-2], steps[1:-1], steps[2:])), axis=0)
    return np.concatenate((steps[:1], three[1], steps[-1:]))


def _line(middle: Floats, lag: Floats) -> Clock:
    """The line through the pieces. AnalysisError where they do not agree."""
    centre = float(middle.mean())
    columns = np.stack((np.ones(middle.size), middle - centre), axis=1)
    fit, off, trust, scale = bisquare_fit(columns, lag, 1e-6)
    if np.mean(np.abs(off) < AGREED) < STEADY:
        raise AnalysisError(
            f"the pieces of the file lie {float(np.std(off)):.2g} samples off one line, less than"
            f" {AGREED:g} are needed in {100.0 * STEADY:g} % of them: its clock is"
            " not steady; lock it to a quartz, or to the board's"
        )
    rms = float(np.sqrt((trust * off**2).sum() / trust.sum()))
    spread = float(np.sqrt((trust * columns[:, 1] ** 2).sum()))
    return Clock(float(fit[0] - fit[1] * centre), 1e6 * float(fit[1]), 1e6 * scale / spread, rms)


# --- gaps -----------------------------------------------------------------------------------------


def _tracked(
    own: Floats, other: Floats, number: Integers, known: tuple[Mark, Clock], steps: Integers
) -> Track:
    mark, clock = known
    keep = np.ones(other.size, dtype=bool)
    shift = np.zeros(other.size, dtype=np.int64)
    gaps = []
    for group in _groups(number, steps):
        around = _around(number, group)
        levels = [int(steps[group[0]]), *(int(steps[before + 1]) for before in group)]
        rows = clock.at(around)
        for gap in find_gaps(own[around], int(around[0]), other, rows, levels):
            gaps.append(gap)
            shift[gap.row :] += gap.lost
            keep[gap.row : gap.row - min(0, gap.lost)] = False
    good = np.flatnonzero(keep)
    first = int(number[0]) * PIECE + PIECE // 2
    after = int(number[-1]) * PIECE + PIECE // 2
    return Track(mark, clock, tuple(gaps), good, good + shift[good], first, after)


def _groups(number: Integers, steps: Integers) -> list[list[int]]:
    """Group the changes of k that are so close that one lies within the other's pieces."""
    groups: list[list[int]] = []
    for before in np.flatnonzero(np.diff(steps)).tolist():
        if groups and number[before] - number[groups[-1][-1] + 1] <= 1:
            groups[-1].append(before)
        else:
            groups.append([before])
    return groups


def _around(number: Integers, group: list[int]) -> Integers:
    """Own samples (n,) of the pieces in which k changes, and half a piece beyond on either side."""
    begin = PIECE * int(number[group[0]]) - PIECE // 2
    after = PIECE * int(number[group[-1] + 1] + 1) + PIECE // 2
    first = PIECE * int(number[0])
    return np.arange(max(first, begin), min(PIECE * int(number[-1] + 1), after))
