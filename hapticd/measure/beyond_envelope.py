"""Negative virtual damping: does it bring the lower edge of the Z-width back to where it was without added damping?

"Future work will address adding negative virtual damping to counteract the additional physical damping in the system and shift the
lower impedance boundary back toward the original undamped boundary" (Weir, Colgate and Peshkin 2008, section 6). Virtual
damping passes through filter, delay and hold, so B < 0 cancels at low frequency only, while the circuit's damping goes on to act
at high frequency, where it is needed.

The grid is that of the paper's search, with rows of B < 0 added in the same steps. The lower edge is where something cancels,
M < 0 the mass or K a mass against a spring, so it lies at the edge of passivity and sinks as a grid gets finer: envelopes are
compared on one grid only. An environment that owns a point of an edge is flown with every seed; where one fails in any, it is
struck out and the next owner is flown, until all owners have passed. Owners are chosen by prediction, not by their own
noise, so their mean over seeds is not biased.

What would break it: Eq. 2 of the paper as a judge of B < 0, where it relaxes (`analysis.requirement` refuses it).
"""

from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Floats, Integers
from hapticd.analysis.boundary import grid
from hapticd.analysis.envelope import Edge
from hapticd.measure.beyond_display import Display, shown_hz, sizes
from hapticd.measure.reproduce_grid import AXES

LOW_HZ = (2.0, 20.0)  # above it the mass of 8 g outweighs the undamped device's damping: |Z| is w m whatever is rendered
NEGATIVE_STEPS = 8
STEP = float(AXES[1][1] - AXES[1][0])
GRID = grid((AXES[0], np.concatenate((-STEP * np.arange(NEGATIVE_STEPS, 0, -1), AXES[1])), AXES[2]))
ROUNDS = 40


@dataclass(frozen=True, slots=True)
class Case:
    """One envelope: `negative` allows B < 0, `dry` counts on dry friction at the perturbation of the trials."""

    name: str
    level: float
    negative: bool = False
    dry: bool = True


@dataclass(frozen=True, eq=False)
class Bounds:
    """Edges of one case over `frequency_hz` (F,), their owners places in `points` (N, 3); sd is that of ln |Z| between seeds.

    `lower_runs`, `upper_runs` (seeds, F): of each seed, the prediction alone (1, F) without trials. `predicted_lower` (F,): of all
    that are predicted to be passive. `struck` failed a trial.
    """

    case: Case
    frequency_hz: Floats
    lower: Edge
    upper: Edge
    points: Floats
    lower_runs: Floats
    upper_runs: Floats
    predicted_lower: Floats
    flown: int
    struck: int

    def lower_db(self, band_hz: tuple[float, float] = LOW_HZ) -> Floats:
        """Mean of the lower edge over ln f [dB re 1 N s/m] (seeds,)."""
        return mean_db(self.frequency_hz, self.lower_runs, band_hz)

    def predicted_db(self, band_hz: tuple[float, float] = LOW_HZ) -> float:
        """The lower edge by prediction alone [dB re 1 N s/m]."""
        return float(mean_db(self.frequency_hz, self.predicted_lower[None], band_hz)[0])

    def width_db(self, band_hz: tuple[float, float] = LOW_HZ) -> Floats:
        """Mean Z-width over ln f [dB] (seeds,)."""
        return mean_db(self.frequency_hz, self.upper_runs / self.lower_runs, band_hz)


def mean_db(frequency_hz: Floats, values: Floats, band_hz: tuple[float, float]) -> Floats:
    """Mean over ln f [dB] (N,) of `values` (N, F) at the frequencies inside the band."""
    inside = (frequency_hz >= band_hz[0]) & (frequency_hz <= band_hz[1])
    place = np.log(frequency_hz[inside])
    return np.asarray(np.trapezoid(20.0 * np.log10(values[:, inside]), place) / (place[-1] - place[0]))


def candidates(display: Display, case: Case, points: Floats = GRID) -> Floats:
    """Environments (N, 3) of the grid that are predicted to be passive in this case."""
    kept = points if case.negative else points[points[:, 1] >= 0.0]
    return np.asarray(kept[display.passive(kept, case.level, case.dry)])


def predicted_bounds(display: Display, case: Case, points: Floats = GRID) -> Bounds:
    """By prediction alone."""
    kept = candidates(display, case, points)
    size = np.abs(display.impedances(kept, case.level))
    owners = size.argmin(axis=0), size.argmax(axis=0)
    return _bounds(case, kept, size[None], owners, size, (0, 0))


def flown_bounds(display: Display, case: Case, seeds: tuple[int, ...], points: Floats = GRID) -> Bounds:
    """By trials of the owners, all of which pass with every seed."""
    kept = candidates(display, case, points)
    size = np.abs(display.impedances(kept, case.level))
    runs: dict[int, Floats] = {}
    alive, flown = np.ones(len(kept), np.bool_), 0
    for _ in range(ROUNDS):
        new = np.setdiff1d(np.concatenate(_owners(size, alive)), np.array(sorted(runs), np.int64))
        if not new.size:
            break
        passed, count = _flown(display, case.level, kept, new, seeds)
        runs |= passed
        flown += count
        alive[np.setdiff1d(new, np.array(sorted(passed), np.int64))] = False
    known = np.array([place in runs for place in range(len(kept))])
    every = np.full((len(seeds), *size.shape), np.nan)
    for place, values in runs.items():
        every[:, place] = values
    return _bounds(case, kept, every, _owners(size, known), size, (flown, int((~alive).sum())))


def hardy(display: Display, bounds: Bounds, seed: int, amplitude: float = 2.0) -> float:
    """Share of the environments that own the lower edge in LOW_HZ which pass with `amplitude` times the force as well."""
    low = (bounds.frequency_hz >= LOW_HZ[0]) & (bounds.frequency_hz <= LOW_HZ[1])
    points = bounds.points[np.unique(bounds.lower.owner[low])]
    return float(np.mean([outcome.passes for outcome in display.flown(points, bounds.case.level, seed, amplitude)]))


def _owners(size: Floats, among: "np.ndarray[tuple[int], np.dtype[np.bool_]]") -> tuple[Integers, Integers]:
    """Who has the least and the largest predicted |Z| (F,)."""
    return np.where(among[:, None], size, np.inf).argmin(axis=0), np.where(among[:, None], size, -np.inf).argmax(axis=0)


def _flown(
    display: Display, level: float, points: Floats, places: Integers, seeds: tuple[int, ...]
) -> tuple[dict[int, Floats], int]:
    """|Z| (seeds, F) of those of `places` that pass with every seed, and how many trials that took."""
    runs: dict[int, list[Floats]] = {int(place): [] for place in places}
    count = 0
    for seed in seeds:
        left = np.array(list(runs), np.int64)
        if not left.size:
            break
        outcomes = display.flown(points[left], level, seed)
        count += len(left)
        for place, outcome in zip(left, outcomes, strict=True):
            if outcome.passes:
                runs[int(place)].append(sizes(outcome))
            else:
                del runs[int(place)]
    return {place: np.array(values) for place, values in runs.items()}, count


def _bounds(
    case: Case, points: Floats, every: Floats, owners: tuple[Integers, Integers], size: Floats, counts: tuple[int, int]
) -> Bounds:
    """`every` (seeds, N, F) of trials, `size` (N, F) by prediction, `counts` of trials and of what they struck out."""
    lower, upper = (np.take_along_axis(every, which[None, None], 1)[:, 0] for which in owners)
    return Bounds(
        case, shown_hz(), _edge(lower, owners[0]), _edge(upper, owners[1]), points, lower, upper, size.min(axis=0), *counts
    )


def _edge(runs: Floats, owner: Integers) -> Edge:
    spread = np.log(runs).std(axis=0, ddof=1) if len(runs) > 1 else np.zeros(runs.shape[1])
    return Edge(np.exp(np.log(runs).mean(axis=0)), spread, owner)
