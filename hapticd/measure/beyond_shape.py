"""Added damping that depends on frequency: what a corner in the damping circuit gives back, and what it costs.

"Future work could address a frequency dependent active damping, since added mechanical dissipation is rarely needed at low
frequency" (Weir, Colgate and Peshkin 2008, section 6). A high-pass takes the dissipation out of slow motion, leaves a mass b / w_l
there, and damps where filtered B and M need it. K is another matter: a sampled spring alone needs b > K t at every frequency,
down to 0, t being half a period and the lag of the loop (Colgate and Schenkel 1997 for T / 2), so a corner costs stiffness on any
device; virtual B beside it gives slow motion its dissipation back. A low-pass does the opposite.

The best high-pass is the one with the lightest free motion among those that keep the limits of B and M within `KEPT`.
"""

from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.boundary import grid
from hapticd.measure.beyond_display import Display, shown_hz
from hapticd.measure.beyond_envelope import LOW_HZ, Bounds, Case, flown_bounds, mean_db, predicted_bounds
from hapticd.measure.beyond_levels import ORIGIN, Limited, limited
from hapticd.measure.reproduce_limits import SET_GRID

HIGHPASS_HZ = (0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 14.0, 20.0, 30.0, 50.0, 100.0)
LOWPASS_HZ = (10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
KEPT = 0.05


@dataclass(frozen=True, slots=True)
class Corner:
    """One corner [Hz], 0 for none: predicted axis limits K, B, M [N/m, N s/m, kg] and mean |Z| of free motion in 2-20 Hz [dB]."""

    highpass_hz: float
    lowpass_hz: float
    limits: tuple[float, float, float]
    free_db: float


@dataclass(frozen=True, eq=False)
class Shaped:
    """`plain` without a corner, `undamped` without damping; `bounds` and `confirmed` are those of the `best` high-pass.

    `stiffest`: largest K [N/m] over the whole set, B and M beside it, predicted, of `plain` and of `best`.
    """

    level: float
    undamped: Corner
    plain: Corner
    highpass: tuple[Corner, ...]
    lowpass: tuple[Corner, ...]
    best: Corner
    bounds: Bounds
    confirmed: tuple[Limited, ...]
    free_runs: Floats
    stiffest: tuple[float, float]


def shaped_damping(display: Display, level: float, seeds: tuple[int, ...]) -> Shaped:
    """All corners at a damping level [N s/m] by prediction, the best one by trials."""
    undamped, plain = _corner(display, 0.0), _corner(display, level)
    highpass = tuple(_corner(display.shaped(highpass_hz=hertz), level, highpass_hz=hertz) for hertz in HIGHPASS_HZ)
    lowpass = tuple(_corner(display.shaped(lowpass_hz=hertz), level, lowpass_hz=hertz) for hertz in LOWPASS_HZ)
    best = min((corner for corner in highpass if _keeps(corner, plain)), key=lambda corner: corner.free_db, default=plain)
    own = display.shaped(highpass_hz=best.highpass_hz) if best.highpass_hz else display
    case = Case("on_shaped", level)
    bounds = flown_bounds(own, case, seeds) if seeds else predicted_bounds(own, case)
    confirmed = tuple(limited(own, level, axis, near, seeds) for axis, near in enumerate(best.limits))
    stiffest = _stiffest(display, level), _stiffest(own, level)
    return Shaped(level, undamped, plain, highpass, lowpass, best, bounds, confirmed, _free_runs(own, level, seeds), stiffest)


def _corner(display: Display, level: float, highpass_hz: float = 0.0, lowpass_hz: float = 0.0) -> Corner:
    limits = (display.limit(level, 0), display.limit(level, 1), display.limit(level, 2))
    free = mean_db(shown_hz(), np.abs(display.impedances(ORIGIN, level)), LOW_HZ)
    return Corner(highpass_hz, lowpass_hz, limits, float(free[0]))


def _stiffest(display: Display, level: float) -> float:
    points = grid(SET_GRID)
    return float(points[display.passive(points, level), 0].max())


def _keeps(corner: Corner, plain: Corner) -> bool:
    return all(corner.limits[axis] / plain.limits[axis] >= 1.0 - KEPT for axis in (1, 2))


def _free_runs(display: Display, level: float, seeds: tuple[int, ...]) -> Floats:
    """Mean |Z| of free motion by trials [dB] (seeds,)."""
    from_trials = [display.sized(ORIGIN, level, seed) for seed in seeds]
    return mean_db(shown_hz(), np.concatenate(from_trials), LOW_HZ) if from_trials else np.empty(0)
