"""The record of another acquisition system beside the daemon's own: where it begins, how its clock
runs, and what it lost.

Both recorded the same force r(i), the other one with a clock of its own, as row

    x(i) = c + (1 + e) i + k(i)

of its file: c the offset, e the difference of the clocks, and k whole numbers, for a file loses
whole samples. A gap of s samples lets k fall by s.

mark        c is found by the mark that the perturbation begins with (`plant.excitation`), a
            sequence of 1023 signs that correlates with nothing but itself: with noise as strong as
            the force its coefficient is 0.7, anything else reaches 0.16 once in a million samples.
            A negative coefficient is an inverted sign.
pieces      From there on the perturbation is its own mark. Each quarter of a second of r is looked
            for in the rows from where the last one was found up to where it should be by now, so a
            gap of any size is crossed. The fraction of a sample is where the correlation between
            the samples, sum Re R(w) F*(w) e^(-jwt), has its peak (Knapp and Carter 1976, "The
            generalized correlation method for estimation of time delay", IEEE ASSP-24).
clock       exp(2 pi j (x - i)) does not know of k: the e at which all pieces agree in phase is
            found with all gaps still in. Then k are the whole numbers that remain, and c and e
            a line through the rest, with bisquare weights.
gaps        between two pieces of different k, and for any k between that a stretch of 256 samples
            shows, the samples are those at which the squares of what does not fit, with the k
            before each and the k after it, are least together (dynamic programming).
what fits   In the end every block of 128 samples is compared with r once more. What fits less than
            half as well as usual is no measurement of it: gaps so close to each other that they
            were taken for one, or rows in which the file stood still.

What would break it: a perturbation that repeats within a few seconds; a clock that wanders by half
a sample over the record (refused: the pieces then do not agree); a gap in the half of a quarter of
a second with which the record begins or ends, which is why those are left out.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hapticd.analysis.arrays import Flags, Floats, Integers
from hapticd.errors import AnalysisError
from hapticd.plant.excitation import mark_signs

PIECE = 1024  # samples that are looked for at once
LEAST = 0.25  # coefficient of a piece or a mark that was found: eight standard deviations of chance
FEWEST = 8  # pieces, for a clock
FASTEST = 1e-3  # difference of two clocks, relative: more is another rate
AGREED = 0.25  # samples off the line at most, of a piece that agrees with it
MOSTLY = 0.5  # of the pieces have to be found
STEADY = 0.8  # of those have to agree: a clock that wanders spreads them evenly
FLAT = 1e-6  # of the mean variance: less is a stretch in which nothing was measured
MARKS = 16  # looked at in one file
ROUNDS = 12
BISQUARE = 4.685  # (Beaton and Tukey 1974)
TAPS = 16  # on either side, of the interpolation between samples
CHUNK = 1 << 15  # samples interpolated at once
NEWTON = 5  # rounds
INNER = 256  # samples, of a stretch between two gaps that lie within a piece
SHORTEST = 64  # samples of such a stretch
LEAST_INNER = 0.4  # its coefficient; chance reaches 0.25
BLOCK = 128  # samples that are compared once more
LEAST_BLOCK = 0.25  # of a block has to be known to be compared
USUAL = 0.5  # of the usual coefficient: a block that fits less is left out
_TINY = float(np.finfo(np.float64).tiny)
NO_MARK = "start the other system before the trial, and run the trial with --mark"


@dataclass(frozen=True, slots=True)
class Mark:
    """Where a mark was found, and how well it fits (1: entirely, negative: inverted)."""

    row: int  # of its first sample
    coefficient: float


@dataclass(frozen=True, slots=True)
class Gap:
    """Samples that the file lost, or has too many of."""

    own_sample: int  # first sample of the own record after the last good row
    lost: int  # samples; negative: rows that stand twice or belong nowhere


@dataclass(frozen=True, slots=True)
class Clock:
    """The line x = offset + (1 + ppm 1e-6) i through the pieces."""

    offset_rows: float  # row of the own sample 0
    ppm: float  # the file's clock is fast by so much
    ppm_sd: float  # standard deviation of it
    residual_samples: float  # rms of the pieces about the line


@dataclass(frozen=True, eq=False)
class Track:
    """Where each row of a file stands on the clock of the file, gaps counted, and that clock beside
    the own one.
    """

    mark: Mark
    clock: Clock
    gaps: tuple[Gap, ...]
    rows: Integers  # (n,) that belong to the record
    place: Integers  # (n,) of each on the file's clock
    first: int  # own sample from which on the record is aligned
    after: int  # own sample after the last

    def at(self, own_samples: Integers) -> Floats:
        """Places (n,) of samples of the own record on the clock of the file."""
        at = self.clock.offset_rows + (1.0 + 1e-6 * self.clock.ppm) * own_samples
        return np.asarray(at, np.float64)


@dataclass(frozen=True, eq=False)
class _Pieces:
    """What was found of each quarter of a second: nan where it was not."""

    lag: Floats  # (n,) rows minus own samples, at the piece's middle

    @property
    def number(self) -> Integers:
        """Those that were found."""
        return np.flatnonzero(np.isfinite(self.lag))

    @property
    def middle(self) -> Floats:
        """Own sample in the middle of each, (n,)."""
        return np.asarray(PIECE * np.arange(self.lag.size) + 0.5 * (PIECE - 1), np.float64)


def find_marks(force: npt.ArrayLike) -> tuple[Mark, ...]:
    """Marks in a signal (n,) of any unit at 4 kHz, in their order; none if there is none."""
    coefficient = _coefficients(mark_signs(), np.asarray(force, np.float64))
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
    pieces = _pieces(own, other, mark.row - mark_at)
    clock, steps = _clock(pieces)
    return _tracked(own, other, pieces, (mark, clock), steps)


def interpolated(values: Floats, at: Floats) -> Floats:
    """`values` (n,) between their samples, at the places `at` (m,): a sinc under a raised cosine
    of 16 samples on either side.
    """
    taps = np.arange(1 - TAPS, TAPS + 1)
    found = np.empty(at.size)
    for first in range(0, at.size, CHUNK):
        part = at[first : first + CHUNK]
        whole = np.floor(part).astype(np.int64)
        away = (part - whole)[:, None] - taps
        weight = np.sinc(away) * (0.5 + 0.5 * np.cos(np.pi * away / TAPS))
        weight /= weight.sum(axis=1, keepdims=True)
        near = np.clip(whole[:, None] + taps, 0, values.size - 1)
        found[first : first + CHUNK] = (weight * values[near]).sum(axis=1)
    return found


def fitting(own_n: Floats, other: Floats, known: Flags) -> Flags:
    """Which samples of `other` (n,), of those `known`, lie in a block that fits `own_n` (n,) [N] at
    least half as well as the usual one.
    """
    count = -(-own_n.size // BLOCK)
    padded = np.zeros((3, count * BLOCK))
    padded[:, : own_n.size] = known * np.stack((own_n, other, np.ones(own_n.size)))
    own, heard, used = padded.reshape(3, count, BLOCK)
    number = np.maximum(used.sum(axis=1, keepdims=True), 1.0)
    own = own - used * own.sum(axis=1, keepdims=True) / number
    heard = heard - used * heard.sum(axis=1, keepdims=True) / number
    power = (own**2).sum(axis=1) * (heard**2).sum(axis=1)
    coefficient = np.abs((own * heard).sum(axis=1)) / np.sqrt(np.maximum(power, _TINY))
    enough = number[:, 0] >= LEAST_BLOCK * BLOCK
    usual = float(np.median(coefficient[enough])) if enough.any() else 0.0
    fits = ~enough | (coefficient >= USUAL * usual)
    return np.asarray(known & np.repeat(fits, BLOCK)[: own_n.size])


# --- where the record is --------------------------------------------------------------------------


def _coefficients(pattern: Floats, signal: Floats) -> Floats:
    """Correlation coefficient of `pattern` (p,) with `signal` (n,) from every row on, (n - p + 1,);
    0 where the signal stands still.
    """
    size = pattern.size
    count = signal.size - size + 1
    if count < 1:
        return np.empty(0)
    shape = pattern - pattern.mean()
    signal = signal - signal.mean()
    points = 1 << (signal.size + size - 1).bit_length()
    spectrum = np.fft.rfft(signal, points) * np.conj(np.fft.rfft(shape, points))
    product = np.fft.irfft(spectrum, points)[:count]
    sums = np.cumsum(np.concatenate(([0.0], signal)))
    squares = np.cumsum(np.concatenate(([0.0], signal**2)))
    power = squares[size:] - squares[:-size] - (sums[size:] - sums[:-size]) ** 2 / size
    least = FLAT * max(float(power.mean()), _TINY)
    scale = np.sqrt(np.maximum(power, least) * float(shape @ shape))
    return np.where(power > least, product / scale, 0.0)


def _mark_of(own: Floats, mark_at: int, other: Floats) -> Mark:
    """The mark after which the own record follows."""
    marks = find_marks(other)
    if not marks:
        best = float(np.abs(_coefficients(mark_signs(), other)).max(initial=0.0))
        raise AnalysisError(
            f"no mark found: looked for {mark_signs().size} pseudo-random signs at 4 kHz in"
            f" {other.size} samples of force, the best coefficient is {best:.2g}, {LEAST:g} is"
            f" needed; {NO_MARK}, or name the force with --force-column"
        )
    scores = [_follows(own, other, mark, mark_at) for mark in marks]
    best_of = int(np.argmax(scores))
    if scores[best_of] < LEAST:
        raise AnalysisError(
            f"a mark at row {marks[best_of].row}, but what follows is not this trial: the best"
            f" coefficient of its first {FEWEST} pieces is {scores[best_of]:.2g}, {LEAST:g} is"
            " needed; name the daemon's record of the same trial with --align"
        )
    return marks[best_of]


def _follows(own: Floats, other: Floats, mark: Mark, mark_at: int) -> float:
    """How well the first pieces of the own record are found after `mark`."""
    sign = np.copysign(1.0, mark.coefficient)
    found = []
    for first in range(0, FEWEST * PIECE, PIECE):
        row = mark.row - mark_at + first
        near = sign * other[max(0, row - PIECE) : max(0, row + 2 * PIECE)]
        found.append(_coefficients(own[first : first + PIECE], near).max(initial=0.0))
    return float(np.max(found))


def _pieces(own: Floats, other: Floats, start: int) -> _Pieces:
    """Each whole piece of the own record in `other`, looked for from the row of the last on;
    `start`: the row of the own sample 0 by the mark.
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
        lag[number] = expected + _fraction(piece, other[row : row + PIECE])
    return _Pieces(lag)


def _found(piece: Floats, other: Floats, lowest: int, highest: int) -> int | None:
    """Row from `lowest` to before `highest` at which `piece` begins; None: it does not."""
    coefficient = _coefficients(piece, other[lowest : highest + PIECE])
    if not coefficient.size:
        return None
    best = int(np.argmax(coefficient))
    return lowest + best if coefficient[best] >= LEAST else None


def _fraction(own: Floats, other: Floats) -> float:
    """By how many samples `other` (n,) comes later than `own` (n,), within -1 to 1."""
    window = np.hanning(own.size)
    cross = np.fft.rfft(window * own) * np.conj(np.fft.rfft(window * other))
    omega = 2.0 * np.pi * np.fft.rfftfreq(own.size)
    late = 0.0
    for _ in range(NEWTON):
        turned = cross * np.exp(-1j * omega * late)
        bent = float((omega**2 * turned.real).sum())
        if bent <= 0.0:
            break
        late = float(np.clip(late + (omega * turned.imag).sum() / bent, -1.0, 1.0))
    return late


# --- how its clock runs ---------------------------------------------------------------------------


def _clock(pieces: _Pieces) -> tuple[Clock, Integers]:
    """The clock, and k (n,) of the pieces that were found, from 0."""
    known = pieces.number
    share = known.size / pieces.lag.size
    if known.size < FEWEST or share < MOSTLY:
        raise AnalysisError(
            f"{known.size} of {pieces.lag.size} pieces of the record were found in the file,"
            f" {100.0 * MOSTLY:g} % are needed: it ends too early, lost too much, or is too noisy;"
            " record the trial again"
        )
    middle = pieces.middle[known]
    lag = pieces.lag[known]
    rate = _rate(pieces)
    phase = float(np.angle(np.exp(2j * np.pi * (lag - rate * middle)).sum())) / (2.0 * np.pi)
    steps = _settled(np.rint(lag - rate * middle - phase).astype(np.int64))
    steps -= steps[0]
    return _line(middle, lag - steps), steps


def _rate(pieces: _Pieces) -> float:
    """The difference of the clocks at which all pieces have one phase, whatever was lost between
    them: first between neighbours, then over longer and longer stretches.
    """
    lag = pieces.lag
    rate = _most_often(lag)
    if not abs(rate) <= FASTEST:
        raise AnalysisError(
            f"the file's clock differs by {1e6 * rate:.4g} ppm, at most {1e6 * FASTEST:g} are"
            " aligned: it was recorded at another rate than 4 kHz, or loses samples all the time;"
            " record at 4 kHz without losses"
        )
    phasor = np.where(np.isfinite(lag), np.exp(2j * np.pi * np.nan_to_num(lag)), 0.0)
    number = np.arange(lag.size)
    apart = 1
    while apart < lag.size:
        turned = phasor * np.exp(-2j * np.pi * rate * PIECE * number)
        sum_of = complex(np.vdot(turned[:-apart], turned[apart:]))
        rate += float(np.angle(sum_of)) / (2.0 * np.pi * PIECE * apart)
        apart *= 2
    return rate


def _most_often(lag: Floats) -> float:
    """The difference of the clocks between most neighbours: its fraction of a sample is known from
    all of them, and the whole samples from those that lost as many as most did, usually none.
    """
    steps = np.diff(lag)
    steps = steps[np.isfinite(steps)]
    if not steps.size:
        return 0.0
    fraction = float(np.angle(np.exp(2j * np.pi * steps).sum())) / (2.0 * np.pi)
    whole, often = np.unique(np.rint(steps - fraction), return_counts=True)
    return float(whole[np.argmax(often)] + fraction) / PIECE


def _settled(steps: Integers) -> Integers:
    """Whole numbers (n,) without those that stand alone: the median of three."""
    if steps.size < 3:
        return steps
    three = np.sort(np.stack((steps[:-2], steps[1:-1], steps[2:])), axis=0)
    return np.concatenate((steps[:1], three[1], steps[-1:]))


def _line(middle: Floats, lag: Floats) -> Clock:
    """The line through the pieces. AnalysisError where they do not agree."""
    centre = float(middle.mean())
    columns = np.stack((np.ones(middle.size), middle - centre), axis=1)
    trust = np.ones(middle.size)
    for _ in range(ROUNDS):
        root = np.sqrt(trust)
        fit = np.linalg.lstsq(columns * root[:, None], lag * root, rcond=None)[0]
        off = lag - columns @ fit
        scale = max(1e-6, 1.4826 * float(np.median(np.abs(off))))
        trust = np.maximum(0.0, 1.0 - (off / (BISQUARE * scale)) ** 2) ** 2
    if np.mean(np.abs(off) < AGREED) < STEADY:
        raise AnalysisError(
            f"the pieces of the file lie {float(np.std(off)):.2g} samples off one line, less than"
            f" {AGREED:g} are needed in {100.0 * STEADY:g} % of them: its clock is"
            " not steady; lock it to a quartz, or to the board's"
        )
    rms = float(np.sqrt((trust * off**2).sum() / trust.sum()))
    spread = float(np.sqrt((trust * columns[:, 1] ** 2).sum()))
    return Clock(float(fit[0] - fit[1] * centre), 1e6 * float(fit[1]), 1e6 * scale / spread, rms)


# --- what it lost ---------------------------------------------------------------------------------


def _tracked(
    own: Floats, other: Floats, pieces: _Pieces, known: tuple[Mark, Clock], steps: Integers
) -> Track:
    mark, clock = known
    number = pieces.number
    keep = np.ones(other.size, dtype=bool)
    shift = np.zeros(other.size, dtype=np.int64)
    gaps = []
    for group in _groups(number, steps):
        around = _around(number, group)
        levels = [int(steps[group[0]]), *(int(steps[before + 1]) for before in group)]
        for gap, row in _gaps(own, other, clock, around, levels):
            gaps.append(gap)
            shift[row:] += gap.lost
            keep[row : row - min(0, gap.lost)] = False
    rows = np.flatnonzero(keep)
    first = int(number[0]) * PIECE + PIECE // 2
    after = int(number[-1]) * PIECE + PIECE // 2
    return Track(mark, clock, tuple(gaps), rows, rows + shift[rows], first, after)


def _groups(number: Integers, steps: Integers) -> list[list[int]]:
    """Where k changes, those together that are so close that one lies in the other's pieces."""
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


def _gaps(
    own: Floats, other: Floats, clock: Clock, around: Integers, levels: list[int]
) -> list[tuple[Gap, int]]:
    """The gaps between several k (`levels`, in their order) in the own samples `around` (n,), each
    with the first row after it.
    """
    rows = np.asarray(clock.offset_rows + (1.0 + 1e-6 * clock.ppm) * around, np.float64)
    part = own[around]
    levels = _with_inner(part, other, rows, levels)
    wrong = _wrong(part, np.stack([interpolated(other, rows + level) for level in levels]))
    long = _long(wrong, levels)
    levels = [level for level, keep in zip(levels, long, strict=True) if keep]
    lost = -np.diff(levels)
    found = []
    for number, end in enumerate(_ends(wrong[long], np.maximum(lost, 0))):
        row = round(float(rows[max(0, end - 1)]) + levels[number]) + 1
        found.append((Gap(int(around[0]) + end, int(lost[number])), row))
    return found


def _with_inner(part: Floats, other: Floats, rows: Floats, levels: list[int]) -> list[int]:
    """`levels` with those between them that a stretch shorter than a piece has: two gaps close to
    each other. `part` (n,): own samples, `rows` (n,): where they are for k = 0.
    """
    seen = set()
    for first in range(0, part.size - INNER + 1, INNER // 2):
        row = round(float(rows[first]))
        lowest = max(0, row + min(levels))
        found = _coefficients(
            part[first : first + INNER], other[lowest : row + max(levels) + INNER]
        )
        if found.size and found.max() >= LEAST_INNER:
            seen.add(lowest + int(np.argmax(found)) - row)
    whole = levels[:1]
    for level in levels[1:]:
        low, high = sorted((whole[-1], level))
        whole += sorted((k for k in seen if low < k < high), reverse=whole[-1] > level)
        whole.append(level)
    return whole


def _wrong(part: Floats, heard: Floats) -> Floats:
    """Squares (levels, n) of what of `part` (n,) does not fit what is heard (levels, n)."""
    power = float(part @ part)
    gain = float((heard @ part).max()) / power if power > 0.0 else 1.0
    return np.asarray((gain * part - heard) ** 2)


def _long(wrong: Floats, levels: list[int]) -> Flags:
    """Which of several k, (levels,), hold for long enough to be one: chance brings in others. The
    first and the last do.
    """
    lost = np.maximum(-np.diff(levels), 0)
    ends = np.array(_ends(wrong, lost))
    holds = np.ones(len(levels), dtype=bool)
    holds[1:-1] = np.diff(ends) - lost[:-1] >= SHORTEST
    return holds


def _ends(wrong: Floats, skipped: Integers) -> list[int]:
    """Where each of several k (but the last) ends, so that the squares that do not fit are least.

    `wrong` (levels, n): squares by each k. `skipped` (levels - 1,): samples lost after each.
    """
    sums = np.cumsum(np.pad(wrong, ((0, 0), (1, 0))), axis=1)
    count = sums.shape[1]
    best = sums[0]
    ways = []
    for total, lost in zip(sums[1:], skipped.tolist(), strict=True):
        entered = np.full(count, np.inf)
        entered[lost:] = best[: count - lost] - total[lost:]
        least = np.minimum.accumulate(entered)
        ways.append(np.maximum.accumulate(np.where(entered <= least, np.arange(count), 0)) - lost)
        best = total + least
    ends = [count - 1]
    for way in reversed(ways):
        ends.append(int(way[ends[-1]]))
    return ends[:0:-1]
