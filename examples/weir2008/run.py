"""Reproduce the paper: its six limits, its arithmetic and the data of Figs. 2, 3, 4, 7-11, on three
simulated devices.

Weir, Colgate and Peshkin, Measuring and increasing Z-width with active electrical damping, 2008.

    predict      limits, sets and envelopes by the first harmonic, in seconds; `quick` stops here
    limits       by trials of 90 s of noise, with every seed; from each lower band edge too
                 (`zwidth.limits`)
    grid         the paper's 6,384 environments, undamped and damped, and the envelope of those that
                 pass (`zwidth.map`)
    singles      the trials of Figs. 4 and 7 (`zwidth.trial`)
    walls        impacts for Fig. 2

Two readings of a limit. Axis: the other two are 0, as the paper's numbers are understood here. Set:
the largest over all passive K, B, M. Its place is predicted. Then only the parameter itself is
searched by trials, from 0 at the predicted best of the others.

Trials of the grid that cannot pass are predicted: even 85 % of the environment would not pass. Only
the others are tried, which reduces a laboratory's 13 days to seconds. Without trials the prediction
alone fills set and envelope.

Limits of different perturbations must not be compared. Limitations: a set that is not star-shaped
about K = B = M = 0, where a passive piece far from the rest would be missed.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cache, partial
from math import isnan, nan

import numpy as np

from examples.weir2008.paper import (
    ADDED_NS_PER_M,
    FIG_4,
    FIG_7,
    HIGH_PASS,
    LEVELS,
    LITERAL,
    MAIN,
)
from hapticd.core.arrays import Flags, Floats
from hapticd.core.errors import AnalysisError
from hapticd.core.units import DEFAULT_BAND_HZ, PROBE_RATE_HZ
from hapticd.model.predict import frequencies
from hapticd.settings.scene import load_scene
from hapticd.signal.impedance import Impedance, impedance
from hapticd.signal.spectra import DEFAULT_LAG
from hapticd.zwidth.executors import pool_of
from hapticd.zwidth.limits import (
    ORIGIN,
    REACH,
    LimitsParams,
    LimitsPlan,
    plan_limits,
    predicted_limit,
    run_plans,
)
from hapticd.zwidth.map import Axes, LevelMap, MapParams, MapPlan, plan_map, run_map
from hapticd.zwidth.outcomes import Conditions, Point, points_of
from hapticd.zwidth.passive_set import Envelope, grid
from hapticd.zwidth.simulated import engine_source
from hapticd.zwidth.sources import Display, Trial
from hapticd.zwidth.store import Progress, Steps, TrialStore, silent
from hapticd.zwidth.trial import TrialParams, TrialResult, plan_trial, run_trial
from hapticd.zwidth.walls import WallMapParams, WallResult, plan_walls, run_walls

__all__ = ["plan_reproduce", "run_reproduce"]

SCENES = {MAIN: "fig7", HIGH_PASS: "rival", LITERAL: "literal"}
SECONDS = 90.0  # of a trial, section 2.2
SEEDS = 8  # noise realisations for a limit on its axis
SET_SEEDS = EDGE_SEEDS = 4  # of the set readings, and of each lower band edge
FINE = 2e-3  # of a limit; two rounds of a search reach it
WINDOW_HZ = PROBE_RATE_HZ / DEFAULT_LAG  # 1/(M Ts): below it the window gives no information
EDGES_HZ = (1.0, 2.0, 3.0, 5.0, 10.0)
LOW_HZ, TOP_HZ = DEFAULT_BAND_HZ
SET_GRID = (np.arange(31) * 50.0, np.arange(19) * 0.5, np.arange(-10, 11) * 0.0025)
SHOWN = (
    (FIG_4, 0.0),
    (FIG_7, 0.0),
    (FIG_7, ADDED_NS_PER_M),
)  # environment and damping of the single trials
SHOWN_HZ = (1.9, 1000.0)  # of every figure
AXES: Axes = (
    np.array([0.0, 25.0, 50.0, 75.0, 100.0, 150.0, 200.0, 300.0, 400.0, 600.0, 800.0, 1000.0]),
    np.asarray(np.arange(19) * 0.5, np.float64),
    np.asarray(np.arange(-12, 16) * 0.002, np.float64),
)
POINTS = grid(AXES)
NEAR = 0.85  # share of a tried environment that must be predicted passive
PEAK_HZ = (40.0, 200.0)  # where the peak of Fig. 8 is searched
PROMINENT = 1.01  # above the valleys on both sides
SMOOTHED = 3  # neighbouring frequencies of a running median, about 10 % of one
WALL_DAMPINGS = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0)  # Ns/m
WALL_STIFFNESSES = tuple(np.geomspace(20.0, 3000.0, 22).tolist())  # N/m


@dataclass(frozen=True, slots=True)
class ReproducePlan:
    """`seeds`: noise realisations for each limit; none: prediction alone, no trials."""

    seeds: tuple[int, ...]
    devices: tuple[str, ...] = tuple(SCENES)


@dataclass(frozen=True, eq=False)
class Limit:
    """Limit of one parameter: `values` (seeds,) by trials, empty without; 0, and nan in
    `predicted`, if nothing is passive.
    """

    device: str
    level: float  # active damping, N s/m
    axis: int  # index into NAMES; in N/m, N s/m or kg
    base: Point  # constant K, B, M of the others
    predicted: float
    values: Floats
    low_hz: float = LOW_HZ  # of the judged band

    @property
    def mean(self) -> float:
        """The mean over seeds; the prediction without trials; 0 if nothing is passive."""
        return float(np.nan_to_num(self.values.mean() if self.values.size else self.predicted))

    @property
    def sd(self) -> float:
        """The standard deviation over seeds; nan with fewer than two."""
        return float(self.values.std(ddof=1)) if self.values.size > 1 else nan


@dataclass(frozen=True, eq=False)
class SingleTrials:
    """Trials of one environment by seed, None for a runaway (no seeds if quick), and the
    prediction's verdict.
    """

    point: Point
    level: float  # active damping, N s/m
    trials: tuple[TrialResult | None, ...]
    predicted: bool

    @property
    def passed(self) -> int:
        """Number of trials that were passive by the paper's rule."""
        return sum(trial is not None and trial.verdict.passes for trial in self.trials)

    @property
    def shown(self) -> Impedance | None:
        """Impedance of the first seed without a runaway, at the frequencies of the figures."""
        found = next((trial.spectra for trial in self.trials if trial is not None), None)
        if found is None:
            return None
        return impedance(
            found.part((found.frequency_hz >= SHOWN_HZ[0]) & (found.frequency_hz <= SHOWN_HZ[1]))
        )


@dataclass(frozen=True, eq=False)
class Peak:
    """A maximum of an envelope: its |Z| [N s/m], its rise above the higher of its valleys, its
    owner (K, B, M).
    """

    frequency_hz: float
    size_ns_per_m: float
    rise: float  # relative
    owner: Floats


@dataclass(frozen=True, eq=False)
class GridResult:
    """The grid at one damping level: the `passive` part (nK, nB, nM), `undecided` of the `trials`
    that passed; the envelope [N s/m], and `environments` (N, 3), into which its owners are indices.
    """

    passive: Flags
    undecided: int
    trials: int
    envelope: Envelope
    environments: Floats

    @property
    def seeds(self) -> int:
        """Seeds of each environment: one, or none if it was predicted."""
        return min(self.trials, 1)

    def peak(self) -> Peak | None:
        """Return the upper edge's most prominent maximum in PEAK_HZ, if any."""
        f = self.envelope.frequency_hz
        edge = self.envelope.upper
        size = _running_median(edge.value) if self.trials else edge.value
        inside = np.flatnonzero((f >= PEAK_HZ[0]) & (f <= PEAK_HZ[1]))
        part = size[inside]
        before = np.minimum.accumulate(part)
        after = np.minimum.accumulate(part[::-1])[::-1]
        rise = part / np.maximum(before, after)
        highest = int(np.argmax(rise))
        if rise[highest] < PROMINENT:
            return None
        at = int(inside[highest])
        return Peak(
            float(f[at]),
            float(size[at]),
            float(rise[highest]) - 1.0,
            self.environments[edge.owner[at]],
        )


@dataclass(frozen=True, eq=False)
class ReproduceResult:
    """`limits` on the axes, `sets` over the whole set, `edges` of K on its axis from each of
    EDGES_HZ; `singles` as in SHOWN.

    `found` is the grid of the first device by trials, `predicted` that of each device; `walls` is
    None if quick.
    """

    plan: ReproducePlan
    limits: tuple[Limit, ...]
    sets: tuple[Limit, ...]
    edges: tuple[Limit, ...]
    singles: dict[str, tuple[SingleTrials, ...]]
    found: tuple[GridResult, ...]
    predicted: dict[str, tuple[GridResult | None, ...]]
    walls: WallResult | None


def plan_reproduce(quick: bool = False, seeds: int = SEEDS) -> ReproducePlan:
    """Return a plan with seeds 1, 2, ..., none if quick."""
    return ReproducePlan(() if quick else tuple(range(1, seeds + 1)))


@cache
def conditions(device: str) -> Conditions:
    """Return the conditions of the paper's trials on one of SCENES, by the name of its device; the
    first seed is 1.
    """
    scene = load_scene(SCENES[device])
    return Conditions(scene, SECONDS, replace(scene.noise, seed=1))


def run_reproduce(
    plan: ReproducePlan, tell: Progress = silent, executor: Executor | None = None
) -> ReproduceResult:
    """Predict all, then make the trials on `executor` or on threads here. ConfigError as for
    `simulate`.
    """
    seeds = len(plan.seeds)
    predicted: dict[str, tuple[GridResult | None, ...]] = {}
    steps = Steps(tell, 2 * len(plan.devices))
    for name in plan.devices:
        steps.next(f"predicting, {name}")
        predicted[name] = tuple(by_prediction(conditions(name).display, level) for level in LEVELS)
    readings = _readings(plan.devices, seeds)
    store = TrialStore(None) if seeds else None
    singles: dict[str, tuple[SingleTrials, ...]] = {}
    with pool_of(executor) as pool:
        for name in plan.devices:
            steps.next(f"Figs. 4 and 7, {name}")
            singles[name] = tuple(
                _single(name, point, level, plan.seeds, pool) for point, level in SHOWN
            )
        limits, sets, edges = (limits_of(asked, store, tell, pool) for asked in readings)
        found = (
            _grid(tell, pool)
            if seeds
            else tuple(each for each in predicted[MAIN] if each is not None)
        )
    wall_params = WallMapParams(load_scene("wall"), WALL_STIFFNESSES, WALL_DAMPINGS, LEVELS)
    walls = run_walls(plan_walls(wall_params), tell) if seeds else None
    return ReproduceResult(plan, limits, sets, edges, singles, found, predicted, walls)


def _readings(devices: tuple[str, ...], seeds: int) -> tuple[list[LimitsPlan], ...]:
    """Plan limits on their axes, over the whole set, and of K from each lower band edge."""
    each = [(name, level) for name in devices for level in LEVELS]
    return (
        [_limits_plan(name, seeds) for name in devices],
        [
            _limits_plan(
                name, min(seeds, SET_SEEDS), (level,), (axis,), set_place(name, level, axis)
            )
            for name, level in each
            for axis in range(3)
        ],
        [
            _limits_plan(name, min(seeds, EDGE_SEEDS), (level,), (0,), low_hz=low_hz)
            for name, level in each
            for low_hz in EDGES_HZ
        ],
    )


def _limits_plan(
    name: str,
    seeds: int,
    levels: tuple[float, ...] = LEVELS,
    axes: tuple[int, ...] = (0, 1, 2),
    base: Point = ORIGIN,
    low_hz: float = LOW_HZ,
) -> LimitsPlan:
    given = replace(conditions(name), band_hz=(low_hz, TOP_HZ), below_window=low_hz < WINDOW_HZ)
    return plan_limits(
        LimitsParams(given, levels, axes=axes, seeds=max(1, seeds), base=base, tolerance=FINE)
    )


def limits_of(
    plans: Sequence[LimitsPlan],
    store: TrialStore | None,
    tell: Progress = silent,
    pool: Executor | None = None,
) -> tuple[Limit, ...]:
    """Return every limit of the plans, in their order: by trials into `store`, or predicted without
    a store. There are no trials if nothing is predicted to be passive.
    """
    asked = [(plan.params, scan) for plan in plans for scan in plan.scans]
    values = {}
    if store is not None:
        passive = [
            replace(plan, scans=tuple(scan for scan in plan.scans if not isnan(scan.predicted)))
            for plan in plans
        ]
        found = run_plans(passive, store, tell, pool)
        values = {
            (one.plan.params, limit.scan): np.nan_to_num(limit.values)
            for one in found
            for limit in one.limits
        }
    return tuple(
        Limit(
            params.conditions.scene.device,
            scan.active_damping_ns_per_m,
            scan.axis,
            params.base,
            scan.predicted,
            values.get((params, scan), np.empty(0)),
            params.conditions.band_hz[0],
        )
        for params, scan in asked
    )


def set_place(device: str, level: float, axis: int) -> Point:
    """Return the start of the search for the set reading of a parameter. Of the places near the
    extreme of the predicted set it is the one that reaches farthest, itself 0; K = B = M = 0 if
    none is passive.
    """
    own = conditions(device).display
    kept = predicted_set(own, level)
    reach = np.abs(kept[:, axis]) * (np.sign(kept[:, axis]) == np.sign(REACH[axis]))
    beside = kept[reach == reach.max(initial=0.0)]
    beside[:, axis] = 0.0
    return max(
        points_of(beside),
        key=lambda place: abs(predicted_limit(own, level, axis, place)),
        default=ORIGIN,
    )


@cache
def predicted_set(device: Display, level: float) -> Floats:
    """Return environments (N, 3) of SET_GRID that are predicted passive at a damping
    level [N s/m].
    """
    points = grid(SET_GRID)
    return np.asarray(points[device.passive(points, level)])


def _single(
    name: str, point: Point, level: float, seeds: tuple[int, ...], pool: Executor
) -> SingleTrials:
    trials = tuple(pool.map(partial(single_trial, name, point, level), seeds))
    return SingleTrials(
        point, level, trials, bool(conditions(name).display.passive(np.array([point]), level)[0])
    )


def single_trial(device: str, point: Point, level: float, seed: int) -> TrialResult | None:
    """Run a trial of Figs. 4 and 7 and drop its record; return None for a runaway before any
    verdict.
    """
    given = conditions(device)
    trial = Trial(point, level, given.seconds, replace(given.excitation, seed=seed))
    try:
        found = run_trial(plan_trial(TrialParams(trial, given.scene)), engine_source(given.scene))
    except AnalysisError:
        return None
    return replace(
        found, recorded=replace(found.recorded, force_n=np.empty(0), velocity_m_per_s=np.empty(0))
    )


def _grid(tell: Progress, pool: Executor) -> tuple[GridResult, ...]:
    """Return the grid of each level, by trials."""
    plan = worth_trying(plan_map(MapParams(conditions(MAIN), AXES, LEVELS)))
    return tuple(_of_map(level) for level in run_map(plan, TrialStore(None), tell, pool).levels)


def worth_trying(plan: MapPlan) -> MapPlan:
    """Return the plan without trials that cannot pass: neither the environment nor NEAR of it is
    predicted passive.
    """
    device = plan.params.conditions.display
    levels = [
        replace(
            level,
            near=level.prediction.passive
            | device.passive(NEAR * POINTS, level.active_damping_ns_per_m),
        )
        for level in plan.levels
    ]
    return replace(plan, levels=tuple(levels))


def _of_map(level: LevelMap) -> GridResult:
    """Return set and envelope of the passed trials, in the order of the grid. AnalysisError if none
    passed.
    """
    passed = [outcome for outcome in level.outcomes if outcome.passes]
    if level.envelope is None:
        raise AnalysisError(
            f"no trial of the grid passed at {level.active_damping_ns_per_m:g} N s/m: there is no"
            " envelope"
        )
    undecided = sum(outcome.answer != "passive" for outcome in passed)
    environments = np.array([outcome.environment for outcome in passed])
    tried = level.tried.reshape(level.found.margin.shape)
    return GridResult(
        level.found.passive & tried, undecided, len(level.outcomes), level.envelope, environments
    )


def by_prediction(device: Display, level: float) -> GridResult | None:
    """Return the same without trials: `undecided` and `trials` are 0, the envelope has no
    uncertainty. None for an empty set.
    """
    passive = device.passive(POINTS, level)
    kept = POINTS[passive]
    if not len(kept):
        return None
    f = frequencies(SHOWN_HZ, device.perturbation)
    f = f[(f >= SHOWN_HZ[0]) & (f <= SHOWN_HZ[1])]
    shape = [axis.size for axis in AXES]
    return GridResult(
        passive.reshape(shape), 0, 0, Envelope.predicted(f, device.impedances(kept, level, f)), kept
    )


def _running_median(values: Floats) -> Floats:
    """Return the running median over the resolution of the window, against the noise of the
    estimate.
    """
    padded = np.pad(values, SMOOTHED // 2, mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, SMOOTHED), axis=1))
