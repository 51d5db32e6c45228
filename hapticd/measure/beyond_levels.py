"""The paper measured with 1.74 N s/m and without. How do the limits grow between and beyond?

For each level of added damping: the three axis limits, the volume of the passive set, and free motion, by prediction; a few
levels are flown. The set is looked at on a grid that grows with the limits, B >= 0, so that its volume does not depend on
where the grid ends.

What would break it: a level at which the damping circuit itself oscillates (`ceiling`), or one that no board can command.
"""

from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.boundary import grid, open_ends, passive_set, volume
from hapticd.measure.beyond_display import Display, shown_hz
from hapticd.measure.beyond_envelope import LOW_HZ, mean_db
from hapticd.plant.stability import damping_ceiling

ORIGIN = np.zeros((1, 3))
HIGHEST = 10.0  # N s/m: full scale of the damping scale factor on the simulated board
LEVELS = (0.0, 0.25, 0.5, 0.87, 1.25, 1.74, 2.25, 2.75, 3.48, 4.5, 6.0, 8.0, HIGHEST)
FLOWN = (0.87, 1.74, 3.48, 8.0)  # half, once and twice the paper's, and far beyond
REACH = (5.0, 1.3, 1.3)  # of the grid, in axis limits of K, B and M; K grows with B and M beside it
HEAVIEST = 2.6  # M > 0, in limits of M < 0 and the device's own mass beside it
STEPS = (13, 12, 16)


@dataclass(frozen=True, eq=False)
class Limited:
    """An axis limit (0 K, 1 B, 2 M) at a level: predicted and by trials (seeds,), empty without."""

    level: float
    axis: int
    predicted: float
    runs: Floats


@dataclass(frozen=True, eq=False)
class Levels:
    """`level` (L,), predicted `limits` (L, 3), `volume` (L,) [N/m N s/m kg], `free_db` (L,); `confirmed` by trials.

    `open_ends` names where a grid did not reach beyond its set; `ceiling` [N s/m] of the device's circuit.
    """

    level: Floats
    limits: Floats
    volume: Floats
    free_db: Floats
    confirmed: tuple[Limited, ...]
    open_ends: tuple[str, ...]
    ceiling: float

    def gain(self, low: float, high: float) -> Floats:
        """Mean growth of the limits (3,) per N s/m between two levels."""
        at = [int(np.argmin(np.abs(self.level - each))) for each in (low, high)]
        return np.asarray((self.limits[at[1]] - self.limits[at[0]]) / (self.level[at[1]] - self.level[at[0]]))


def limited(display: Display, level: float, axis: int, near: float, seeds: tuple[int, ...]) -> Limited:
    """The limit that was predicted to be `near`, by trials."""
    return Limited(level, axis, near, display.limits_by_trials(level, axis, near, seeds))


def damping_levels(display: Display, seeds: tuple[int, ...]) -> Levels:
    """All levels by prediction, FLOWN by trials."""
    limits = np.array([[display.limit(level, axis) for axis in range(3)] for level in LEVELS])
    sets = [_set(display, level, limits[place]) for place, level in enumerate(LEVELS)]
    free = [mean_db(shown_hz(), np.abs(display.impedances(ORIGIN, level)), LOW_HZ)[0] for level in LEVELS]
    confirmed = [
        limited(display, level, axis, limits[LEVELS.index(level), axis], seeds) for level in FLOWN for axis in range(3) if seeds
    ]
    return Levels(
        np.array(LEVELS), limits, np.array([found[0] for found in sets]), np.array(free), tuple(confirmed),
        tuple(dict.fromkeys(f"{end} at {level:g} N s/m" for level, found in zip(LEVELS, sets, strict=True) for end in found[1])),
        damping_ceiling(display.model),
    )  # fmt: skip


def _set(display: Display, level: float, limits: Floats) -> tuple[float, tuple[str, ...]]:
    """Volume, and upper or lower ends at which the grid was too small; K and B begin at 0 by definition."""
    k, b, m = limits * np.asarray(REACH)
    axes = (
        np.linspace(0.0, k, STEPS[0]),
        np.linspace(0.0, b, STEPS[1]),
        np.linspace(m, -HEAVIEST * m + display.model.mass_kg, STEPS[2]),
    )
    found = passive_set(axes, display.predicted(grid(axes), level).decided_margin)
    return volume(found), tuple(end for end in open_ends(found) if end not in ("K min", "B min"))
