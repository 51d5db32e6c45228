"""Reproduce the paper: its six limits, its arithmetic and the data of Figs. 2, 3, 4, 7-11, on three simulated devices.

Weir, Colgate and Peshkin, Measuring and increasing Z-width with active electrical damping, 2008.

    predict      limits, sets and envelopes by the first harmonic, in seconds; all that `quick` does
    trials       90 s of noise each: limits around the prediction for every seed, the grid, the trials of Figs. 4 and 7
    walls        impacts for Fig. 2

What would break it: comparing a limit of one perturbation with that of another.
"""

from dataclasses import dataclass, replace
from itertools import product
from math import isnan
from typing import Any

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.analysis.impedance import Impedance
from hapticd.analysis.spectra import Spectra
from hapticd.measure import reproduce_grid as grids
from hapticd.measure import reproduce_limits as searches
from hapticd.measure.progress import Progress, Steps, silent
from hapticd.measure.reproduce_grid import Found
from hapticd.measure.reproduce_limits import Limit
from hapticd.measure.reproduce_rows import LITERAL
from hapticd.measure.reproduce_tasks import EDGE_SEEDS, SET_SEEDS, SHOWN, Key, worked
from hapticd.measure.reproduce_trials import LEVELS, MAIN, SCENES, Point, passes, subject
from hapticd.measure.walls import WallResult

SEEDS = 8
ORIGIN: Point = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class ReproduceParams:
    """`quick`: prediction alone, no trials. `seeds`: noise realisations behind each limit."""

    quick: bool = False
    seeds: int = SEEDS
    devices: tuple[str, ...] = tuple(SCENES)


@dataclass(frozen=True, slots=True)
class ReproducePlan:
    """What will be done; the tasks of later stages depend on earlier ones."""

    params: ReproduceParams
    seeds: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Single:
    """Trials of one environment: spectra by seed, None of one that ran away (no seeds if quick), and the prediction's verdict."""

    point: Point
    level: float
    trials: tuple[Spectra | None, ...]
    predicted: bool

    @property
    def flown(self) -> int:
        """How many trials there were."""
        return len(self.trials)

    @property
    def passed(self) -> int:
        """How many were passive."""
        return sum(map(passes, self.trials))

    @property
    def shown(self) -> Impedance | None:
        """Of the first seed that did not run away."""
        return next((grids.shown(trial) for trial in self.trials if trial is not None), None)


@dataclass(frozen=True, eq=False)
class ReproduceResult:
    """`limits` on the axes, `sets` over the whole set; `edges` {(device, level): (seeds, EDGES_HZ)}; `singles` as in SHOWN.

    `found` is the grid of the first device by trials, `predicted` that of each device; `walls` is None if quick.
    """

    plan: ReproducePlan
    limits: tuple[Limit, ...]
    sets: tuple[Limit, ...]
    edges: dict[tuple[str, float], Floats]
    singles: dict[str, tuple[Single, ...]]
    found: tuple[Found, ...]
    predicted: dict[str, tuple[Found | None, ...]]
    walls: WallResult | None


def plan_reproduce(params: ReproduceParams) -> ReproducePlan:
    """Seeds 1, 2, ..., none if quick."""
    return ReproducePlan(params, () if params.quick else tuple(range(1, params.seeds + 1)))


def run_reproduce(plan: ReproducePlan, tell: Progress = silent) -> ReproduceResult:
    """Do it. ConfigError as `simulate`."""
    devices = plan.params.devices
    axis: list[Limit] = []
    whole: list[Limit] = []
    predicted: dict[str, tuple[Found | None, ...]] = {}
    steps = Steps(tell, len(devices))
    for name in devices:
        steps.next(f"predicting, {name}")
        for level, k in product(LEVELS, range(3)):
            axis.append(_predicted(name, level, k, ORIGIN))
            whole.append(_predicted(name, level, k, searches.set_place(name, level, k)))
        predicted[name] = tuple(_by_prediction(name, level) for level in LEVELS)
    done = worked(devices, plan.seeds, axis, whole, tell) if plan.seeds else {}
    tell("done", 1, 1)
    return ReproduceResult(
        plan,
        limits=tuple(gathered(limit, "axis", plan.seeds, done) for limit in axis),
        sets=tuple(gathered(limit, "set", plan.seeds[:SET_SEEDS], done) for limit in whole),
        edges={(name, level): _edges(plan, done, name, level) for name in devices for level in LEVELS},
        singles={name: tuple(_single(plan, done, name, place) for place in range(len(SHOWN))) for name in devices},
        found=tuple(_found(done, level, predicted[MAIN][place]) for place, level in enumerate(LEVELS)),
        predicted=predicted,
        walls=done.get(("walls",)),
    )


def _predicted(name: str, level: float, axis: int, base: Point | None) -> Limit:
    value = float("nan") if base is None else searches.predicted_limit(name, level, axis, base)
    return Limit(name, level, axis, base or ORIGIN, value, np.empty(0))


def _by_prediction(name: str, level: float) -> Found | None:
    if name == LITERAL and level == 0.0:
        return None
    return grids.by_prediction(subject(name), level)


def gathered(limit: Limit, reading: str, seeds: tuple[int, ...], done: dict[Key, Any]) -> Limit:
    """A predicted limit with what each seed found; `reading` is "axis" or "set". Where nothing is passive none was flown."""
    if isnan(limit.predicted):
        return limit
    values = np.array([done[reading, limit.device, limit.level, limit.axis, seed] for seed in seeds])
    return replace(limit, values=np.nan_to_num(values))  # 0 where not even the rest is passive


def _edges(plan: ReproducePlan, done: dict[Key, Any], name: str, level: float) -> Floats:
    if not plan.seeds:
        return searches.predicted_edge_limits(name, level)[None]
    return np.array([done["edge", name, level, seed] for seed in plan.seeds[:EDGE_SEEDS]])


def _single(plan: ReproducePlan, done: dict[Key, Any], name: str, place: int) -> Single:
    point, level = SHOWN[place]
    predicted = bool(subject(name).passive(np.array([point]), level)[0])
    return Single(point, level, tuple(done["single", name, place, seed] for seed in plan.seeds), predicted)


def _found(done: dict[Key, Any], level: float, predicted: Found | None) -> Found:
    parts = [(key, value) for key, value in done.items() if key[0] == "grid" and key[1] == level]
    if not parts:
        assert predicted is not None
        return predicted
    return grids.by_trials(level, [pair for _, value in parts for pair in value], sum(key[3] for key, _ in parts))
