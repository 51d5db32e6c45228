"""Reproduce the paper: its six limits, its arithmetic and the data of Figs. 2, 3, 4, 7-11, on three simulated devices.

Weir, Colgate and Peshkin, Measuring and increasing Z-width with active electrical damping, 2008.

    predict      limits, sets and envelopes by the first harmonic, in seconds; all that `quick` does
    trials       90 s of noise each: limits around the prediction for every seed, the grid, the trials of Figs. 4 and 7
    walls        impacts for Fig. 2

What would break it: comparing a limit of one perturbation with that of another.
"""

from dataclasses import dataclass, field, replace
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
from hapticd.measure.reproduce_walls import DAMPINGS

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
    """Trials of one environment: spectra by seed (none if quick), how many of them passed, and the prediction's verdict."""

    point: Point
    level: float
    trials: tuple[Spectra, ...]
    passed: int
    flown: int
    predicted: bool

    @property
    def shown(self) -> Impedance | None:
        """Of the first seed."""
        return grids.shown(self.trials[0]) if self.trials else None


@dataclass(frozen=True, eq=False)
class ReproduceResult:
    """`limits` on the axes, `sets` over the whole set; `edges` {(device, level): (seeds, EDGES_HZ)}; `singles` as in SHOWN."""

    plan: ReproducePlan
    limits: tuple[Limit, ...]
    sets: tuple[Limit, ...]
    edges: dict[tuple[str, float], Floats]
    singles: dict[str, tuple[Single, ...]]
    found: tuple[Found, ...]
    predicted: dict[str, tuple[Found | None, ...]]
    walls: dict[float, Floats] = field(default_factory=dict)


def plan_reproduce(params: ReproduceParams) -> ReproducePlan:
    """Seeds 1, 2, ..., none if quick."""
    return ReproducePlan(params, () if params.quick else tuple(range(1, params.seeds + 1)))


def run_reproduce(plan: ReproducePlan, tell: Progress = silent) -> ReproduceResult:
    """Do it. ConfigError as `simulate`."""
    devices = plan.params.devices
    steps = Steps(tell, 1)
    steps.next("predicting")
    axis = [_predicted(name, level, k, ORIGIN) for name in devices for level in LEVELS for k in range(3)]
    whole = [_predicted(name, level, k, _place(name, level, k)) for name in devices for level in LEVELS for k in range(3)]
    predicted = {name: tuple(_by_prediction(name, level) for level in LEVELS) for name in devices}
    done = worked(plan.params.devices, plan.seeds, axis, whole, tell) if plan.seeds else {}
    edges = {(name, level): _edges(plan, done, name, level) for name in devices for level in LEVELS}
    found = tuple(_found(done, level, predicted[MAIN][place]) for place, level in enumerate(LEVELS))
    tell("done", 1, 1)
    return ReproduceResult(
        plan,
        limits=tuple(_gathered(limit, "axis", plan.seeds, done) for limit in axis),
        sets=tuple(_gathered(limit, "set", plan.seeds[:SET_SEEDS], done) for limit in whole),
        edges=edges,
        singles={name: tuple(_single(plan, done, name, place) for place in range(len(SHOWN))) for name in devices},
        found=found,
        predicted=predicted,
        walls={level: np.array([done["wall", level, b] for b in DAMPINGS]) for level in LEVELS} if plan.seeds else {},
    )


def _predicted(name: str, level: float, axis: int, base: Point | None) -> Limit:
    value = float("nan") if base is None else searches.predicted_limit(name, level, axis, base)
    return Limit(name, level, axis, base or ORIGIN, value, np.empty(0))


def _place(name: str, level: float, axis: int) -> Point | None:
    return searches.set_place(name, level, axis)


def _by_prediction(name: str, level: float) -> Found | None:
    if name == LITERAL and level == 0.0:
        return None
    return grids.by_prediction(subject(name), level)


def _gathered(limit: Limit, reading: str, seeds: tuple[int, ...], done: dict[Key, Any]) -> Limit:
    values = np.array([done[reading, limit.device, limit.level, limit.axis, seed] for seed in seeds])
    return replace(limit, values=values)


def _edges(plan: ReproducePlan, done: dict[Key, Any], name: str, level: float) -> Floats:
    if not plan.seeds:
        return searches.predicted_edge_limits(name, level)[None]
    return np.array([done["edge", name, level, seed] for seed in plan.seeds[:EDGE_SEEDS]])


def _single(plan: ReproducePlan, done: dict[Key, Any], name: str, place: int) -> Single:
    point, level = SHOWN[place]
    trials = [done["single", name, place, seed] for seed in plan.seeds]
    predicted = bool(subject(name).passive(np.array([point]), level)[0])
    whole = tuple(trial for trial in trials if trial is not None)
    return Single(point, level, whole, sum(map(passes, trials)), len(trials), predicted)


def _found(done: dict[Key, Any], level: float, predicted: Found | None) -> Found:
    parts = [(key, value) for key, value in done.items() if key[0] == "grid" and key[1] == level]
    if not parts:
        assert predicted is not None
        return predicted
    return grids.by_trials(level, [pair for _, value in parts for pair in value], sum(key[3] for key, _ in parts))


__all__ = ["ReproduceParams", "ReproducePlan", "ReproduceResult", "Single", "plan_reproduce", "run_reproduce"]
