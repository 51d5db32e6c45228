"""Beyond the paper: what Weir, Colgate and Peshkin (2008, section 6) left for future work, on the calibrated device.

    envelopes    negative virtual damping under added damping: the lower edge of the Z-width (`beyond_envelope`)
    free         the same in free motion, with what is left of passivity (`beyond_motion`)
    shaped       added damping above or below a corner frequency (`beyond_shape`)
    levels       limits, volume and free motion over the level of added damping (`beyond_levels`)
    searches     the directed search against the grid (`beyond_search`), not by prediction alone

Prediction carries the load; 90 s trials confirm what is shown, each with every seed. `quick` predicts alone.
"""

from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.measure.beyond_display import Display
from hapticd.measure.beyond_envelope import Bounds, Case, flown_bounds, hardy, predicted_bounds
from hapticd.measure.beyond_levels import Levels, damping_levels
from hapticd.measure.beyond_motion import Free, free_motion
from hapticd.measure.beyond_search import Compared, compared_with_grid
from hapticd.measure.beyond_shape import Shaped, shaped_damping
from hapticd.measure.outcomes import Conditions
from hapticd.measure.progress import Progress, Steps, silent
from hapticd.measure.reproduce_trials import ADDED_NS_PER_M, LEVELS, MAIN, SCENES, SECONDS
from hapticd.measure.scenes import noise
from hapticd.settings.scene import load_scene

SEEDS = 3
CASES = (
    Case("off", 0.0),
    Case("on", ADDED_NS_PER_M),
    Case("on_negative_B", ADDED_NS_PER_M, negative=True),
    Case("off_negative_B", 0.0, negative=True),
    Case("off_safe", 0.0, dry=False),
    Case("on_safe", ADDED_NS_PER_M, dry=False),
    Case("on_negative_B_safe", ADDED_NS_PER_M, negative=True, dry=False),
)


@dataclass(frozen=True, slots=True)
class BeyondParams:
    """`quick`: prediction alone. `seeds`: noise realisations that everything shown passes with."""

    quick: bool = False
    seeds: int = SEEDS


@dataclass(frozen=True, eq=False)
class BeyondPlan:
    """The device, and the seeds, none if quick."""

    params: BeyondParams
    display: Display
    seeds: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class BeyondResult:
    """`envelopes` by the name of their case; `hardy`: share of the low owners of an envelope that pass at twice the force."""

    plan: BeyondPlan
    envelopes: dict[str, Bounds]
    hardy: dict[str, float]
    free: Free
    shaped: Shaped
    levels: Levels
    searches: tuple[Compared, ...]


def plan_beyond(params: BeyondParams) -> BeyondPlan:
    """ConfigError as `load_scene`."""
    display = Display(load_scene(SCENES[MAIN]))
    return BeyondPlan(params, display, () if params.quick else tuple(range(1, params.seeds + 1)))


def run_beyond(plan: BeyondPlan, tell: Progress = silent) -> BeyondResult:
    """Do it. ConfigError as `simulate`."""
    display, seeds = plan.display, plan.seeds
    steps, envelopes = Steps(tell, len(CASES) + 3 + (len(LEVELS) if seeds else 0)), {}
    for case in CASES:
        steps.next(f"envelope, {case.name}")
        envelopes[case.name] = flown_bounds(display, case, seeds) if seeds else predicted_bounds(display, case)
    survived = {name: hardy(display, bounds, seeds[0]) for name, bounds in envelopes.items() if seeds}
    steps.next("free motion")
    free = free_motion(display, ADDED_NS_PER_M, seeds)
    steps.next("shaped damping")
    shaped = shaped_damping(display, ADDED_NS_PER_M, seeds)
    steps.next("levels of damping")
    levels = damping_levels(display, seeds)
    searches = []
    for level in LEVELS if seeds else ():
        steps.next(f"directed search, {level:g} N s/m")
        searches.append(compared_with_grid(Conditions(display.scene, SECONDS, noise(display.scene)), level))
    steps.end()
    return BeyondResult(plan, envelopes, survived, free, shaped, levels, tuple(searches))


def mean_sd(runs: Floats) -> tuple[float, float]:
    """Mean and standard deviation over seeds, the latter nan with less than two."""
    return float(np.mean(runs)), float(np.std(runs, ddof=1)) if len(runs) > 1 else float("nan")
