"""The future work of Weir, Colgate and Peshkin (2008, section 6), on the calibrated device.

Everything is predicted first; trials of 90 s, with every seed, confirm the shown results. `quick`
omits the confirmation.

Envelopes. "Future work will address adding negative virtual damping to counteract the additional
physical damping in the system and shift the lower impedance boundary back toward the original
undamped boundary". Virtual damping passes through filter, delay and hold. So B < 0 cancels only at
low frequency, while the circuit's damping continues to act at high frequency, where it is needed.
The grid is that of the paper's search, with rows of B < 0 added in the same steps. The lower edge
lies where something cancels: M < 0 the mass, or K a mass against a spring. So it is at the edge of
passivity and falls as a grid gets finer: envelopes are compared on one grid only. An environment
that owns a point of an edge is tried with every seed. If it fails with any, it is excluded and the
next owner is tried, until all owners have passed. Owners are chosen by prediction, not by their own
noise, so their mean over seeds is not biased.

Free motion. K = 0, so there is no resonance and the grid is irrelevant: |Z| is damping, mass, and
the reduction by negative virtual damping. The law's lag t turns B < 0 into a mass, -|B| e^(-jwt) =
-|B| + jw |B| t, about 14 g with the 1.74 N s/m of the paper. So B < 0 alone restores the damping
but not the motion; M < 0 in addition does. Two limits differ. At the perturbation of the trials dry
friction carries a part of B < 0; this fades as the motion grows, until the device runs away.
`lightest_safe` therefore also requires the lifted theorem of Colgate and Schenkel, without
friction, for every input. The best safe (B, M) has the minimum mean |Z| in dB over 2-20 Hz.

Shaped damping. "Future work could address a frequency dependent active damping, since added
mechanical dissipation is rarely needed at low frequency". A high-pass removes the dissipation from
slow motion, leaves a mass b / w_l there, and damps where filtered B and M need it. K differs: a
sampled spring alone needs b > K t at every frequency, down to 0. Here t is half a period and the
lag of the loop (Colgate and Schenkel 1997 for T / 2). So a corner costs stiffness on any device;
virtual B in addition restores the dissipation of slow motion. A low-pass does the opposite. The
best high-pass has the lightest free motion among those that keep the limits of B and M within
`KEPT`.

Levels. The paper measured with 1.74 N s/m and without. Here limits are computed between and above
these levels: the three axis limits, the volume of the passive set, and free motion, by prediction.
A few levels are confirmed by trials. The set is evaluated on a grid that grows with the limits, B
>= 0, so that its volume does not depend on the ends of the grid.

Searches. The directed search is compared with the grid that it replaces: a grid of 2,002
environments is tried twice completely, with different noise. The first is the reference; the
difference of the second is the floor, the accuracy of one grid at the boundary. The search has its
own noise. A point is wrong where the search, or the prediction alone, differs from the reference;
shares are relative to the passive points.

Limitations: Eq. 2 of the paper for B < 0, where it relaxes (`model.theorem` refuses it). A level at
which the damping circuit itself oscillates (`model.discrete`), or one that no board can command.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from examples.weir2008.paper import ADDED_NS_PER_M, LEVELS, MAIN, paper_equation_2
from examples.weir2008.run import AXES, FINE, Limit, conditions, limits_of, predicted_set
from hapticd.core.arrays import Flags, Floats, Integers
from hapticd.core.errors import AnalysisError
from hapticd.model.effects import ShapedDamping
from hapticd.model.theorem import lifted_margin, lifted_passive, lifted_system
from hapticd.zwidth.acquisition import predicted_passive
from hapticd.zwidth.compare import mean_over_ln_f
from hapticd.zwidth.limits import ORIGIN, REACH, LimitsParams, plan_limits, predicted_limit
from hapticd.zwidth.map import Axes, MapParams, plan_map, run_map
from hapticd.zwidth.outcomes import (
    Conditions,
    Outcome,
    Point,
    TrialBatch,
    kept_frequencies,
    outcomes_of,
    points_of,
)
from hapticd.zwidth.passive_set import Edge, PassiveSet, grid
from hapticd.zwidth.search import SearchParams, SearchResult, observed, plan_search, run_search
from hapticd.zwidth.sources import Display
from hapticd.zwidth.store import Progress, Steps, TrialStore, silent

__all__ = ["plan_future_work", "run_future_work"]

SEEDS = 3  # noise realisations for every shown result
FREE = np.array([ORIGIN])  # motion: nothing is rendered
SHOWN_HZ = (2.0, 200.0)  # of every figure here
# Above 20 Hz the mass of 8 g outweighs the undamped device's damping: there |Z| is w m, for any
# environment.
LOW_HZ = (2.0, 20.0)
NEGATIVE_STEPS = 8  # rows of B < 0
STEP = float(AXES[1][1] - AXES[1][0])
GRID = grid((AXES[0], np.concatenate((-STEP * np.arange(NEGATIVE_STEPS, 0, -1), AXES[1])), AXES[2]))
ROUNDS = 40  # of trials of new owners, at most
FURTHEST = -12.0  # N s/m, of a predicted search of B
DAMPINGS = 41  # values of B evaluated
MASSES = 25  # and of M
HIGHPASS_HZ = (0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 14.0, 20.0, 30.0, 50.0, 100.0)
LOWPASS_HZ = (10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
KEPT = 0.05  # share of the limits of B and M that a corner may cost
HIGHEST = 10.0  # N s/m: full scale of the damping scale factor on the simulated board
DAMPING_LEVELS = (0.0, 0.25, 0.5, 0.87, 1.25, 1.74, 2.25, 2.75, 3.48, 4.5, 6.0, 8.0, HIGHEST)
TRIED_LEVELS = (0.87, 1.74, 3.48, 8.0)  # N s/m: half, once and twice the paper's, and far above
ROOM = (5.0, 1.3, 1.3)  # of the grid, in axis limits of K, B and M; K grows with B and M
HEAVIEST = 2.6  # M > 0, in limits of M < 0, plus the device's own mass
STEPS = (13, 12, 16)  # points of that grid along K, B and M
SEARCH_SEED = 101  # noise of the directed search
GRID_SEEDS = (1, 2)  # noise of the reference grid, and of the second one
BUDGETS = (20, 40)  # trials
SEARCHED: dict[float, Axes] = {  # the grid of K, B, M at each active damping
    LEVELS[0]: (
        np.linspace(0.0, 450.0, 14),
        np.linspace(0.0, 4.0, 11),
        np.linspace(-0.010, 0.016, 13),
    ),
    LEVELS[1]: (
        np.linspace(0.0, 1400.0, 14),
        np.linspace(0.0, 10.0, 11),
        np.linspace(-0.028, 0.040, 13),
    ),
}


@dataclass(frozen=True, eq=False)
class Bench:
    """A display with variable environment and active damping: predicted in microseconds, or tried,
    each trial once.
    """

    conditions: Conditions
    store: TrialStore = field(default_factory=lambda: TrialStore(None), repr=False)

    @property
    def display(self) -> Display:
        """The prepared device."""
        return self.conditions.display

    def sizes(self, points: Floats, level: float) -> Floats:
        """Return predicted |Z| (N, F) at `shown_hz()` of environments (N, 3)."""
        return np.abs(self.display.impedances(points, level, shown_hz()))

    def trials(
        self, points: Floats, level: float, seed: int, amplitude: float = 1.0
    ) -> list[Outcome]:
        """Run a trial of each environment (N, 3) with the noise of `seed`, its force multiplied by
        `amplitude`.
        """
        given = self.conditions.perturbed(amplitude, seed - self.conditions.excitation.seed)
        return outcomes_of(TrialBatch(given, level, points_of(points)), self.store)

    def limit(self, level: float, axis: int, reach: float | None = None) -> float:
        """Return the predicted axis limit, the others 0: N/m, Ns/m, kg."""
        return predicted_limit(self.display, level, axis, reach=reach)

    def limits(
        self,
        levels: tuple[float, ...],
        seeds: tuple[int, ...],
        axes: tuple[int, ...] = (0, 1, 2),
        reach: Point = REACH,
    ) -> tuple[Limit, ...]:
        """Return axis limits, by trials with `seeds`; predicted without seeds."""
        plan = plan_limits(
            LimitsParams(
                self.conditions,
                levels,
                axes=axes,
                seeds=max(1, len(seeds)),
                reach=reach,
                tolerance=FINE,
            )
        )
        return limits_of([plan], self.store if seeds else None)

    def shaped(self, highpass_hz: float = 0.0, lowpass_hz: float = 0.0) -> "Bench":
        """Return the same device with shaped damping."""
        effect = ShapedDamping(highpass_hz=highpass_hz, lowpass_hz=lowpass_hz)
        scene = self.conditions.scene
        return Bench(
            replace(self.conditions, scene=replace(scene, effects=(*scene.effects, effect))),
            self.store,
        )


def shown_hz() -> Floats:
    """Return the frequencies (F,) of every impedance here, those of outcomes inside SHOWN_HZ."""
    f = kept_frequencies()
    return f[(f >= SHOWN_HZ[0]) & (f <= SHOWN_HZ[1])]


def sizes(outcome: Outcome) -> Floats:
    """Return |Z| (F,) of a trial at `shown_hz()`."""
    return np.asarray(np.hypot(*outcome.z.T)[np.isin(outcome.frequency_hz, shown_hz())])


@dataclass(frozen=True, slots=True)
class Case:
    """One envelope: `negative` permits B < 0, `dry` includes dry friction at the perturbation of
    the trials.
    """

    name: str
    level: float  # active damping, N s/m
    negative: bool = False
    dry: bool = True


@dataclass(frozen=True, eq=False)
class Bounds:
    """Edges of one case over `shown_hz()` (F,); their owners are indices into `points` (N, 3); sd
    is that of ln |Z| between seeds.

    `lower_runs`, `upper_runs` (seeds, F): of each seed, the prediction alone (1, F) without trials.
    `predicted_lower` (F,): of all environments predicted to be passive. `excluded` environments
    failed a trial.
    """

    case: Case
    lower: Edge
    upper: Edge
    points: Floats
    lower_runs: Floats
    upper_runs: Floats
    predicted_lower: Floats
    trials: int
    excluded: int

    def lower_db(self) -> Floats:
        """Return the mean of the lower edge over ln f [dB re 1 N s/m] (seeds,)."""
        return mean_db(shown_hz(), self.lower_runs, LOW_HZ)

    def predicted_db(self) -> float:
        """Return the predicted lower edge [dB re 1 N s/m]."""
        return float(mean_db(shown_hz(), self.predicted_lower[None], LOW_HZ)[0])

    def width_db(self) -> Floats:
        """Return the mean Z-width over ln f [dB] (seeds,)."""
        return mean_db(shown_hz(), self.upper_runs / self.lower_runs, LOW_HZ)


@dataclass(frozen=True, eq=False)
class Motion:
    """|Z| [N s/m] of one environment without K over `shown_hz()`.

    `predicted` has the shape (F,), `runs` (seeds, F) those of the passing trials, possibly none.

    `reserve_ns_per_m`: margin of damping by the lifted theorem, without friction.
    """

    name: str
    level: float  # active damping, N s/m
    virtual_damping: float  # virtual damping B, N s/m
    mass_kg: float  # virtual mass M
    predicted: Floats
    runs: Floats
    reserve_ns_per_m: float

    @property
    def size(self) -> Edge:
        """Mean over trials, with the sd of ln |Z| between seeds; the prediction without trials."""
        no_owner = np.zeros(self.predicted.size, np.int64)
        return _edge(self.runs if len(self.runs) else self.predicted[None], no_owner)

    def low_db(self) -> Floats:
        """Return the mean over ln f in 2-20 Hz [dB re 1 N s/m], (seeds,), or of the prediction (1,)
        without trials.
        """
        return mean_db(shown_hz(), self.runs if len(self.runs) else self.predicted[None], LOW_HZ)

    def predicted_db(self) -> float:
        """Return the same by prediction alone."""
        return float(mean_db(shown_hz(), self.predicted[None], LOW_HZ)[0])


@dataclass(frozen=True, eq=False)
class FreeMotion:
    """`motions`: off, on, on_negative_B, on_negative_BM. `limits`: of B downwards, without and with
    damping.

    `refusal`: answer of Eq. 2 for B alone.
    """

    motions: tuple[Motion, ...]
    limits: tuple[Limit, ...]
    refusal: str


@dataclass(frozen=True, slots=True)
class Corner:
    """One corner of the damping [Hz], 0 for none: predicted axis limits K, B, M [N/m, N s/m, kg]
    and mean |Z| of free motion in 2-20 Hz [dB]."""

    corner_hz: float
    limits: tuple[float, float, float]
    free_db: float


@dataclass(frozen=True, eq=False)
class ShapedResult:
    """`plain` without a corner, `undamped` without damping; `bounds`, `confirmed` and `free` motion
    are those of the `best` high-pass.

    `stiffest`: largest predicted K [N/m] over the whole set, with any B and M, of `plain` and of
    `best`.
    """

    level: float  # active damping, N s/m
    undamped: Corner
    plain: Corner
    highpass: tuple[Corner, ...]
    lowpass: tuple[Corner, ...]
    best: Corner
    bounds: Bounds
    confirmed: tuple[Limit, ...]
    free: Motion
    stiffest: tuple[float, float]


@dataclass(frozen=True, eq=False)
class DampingLevels:
    """`level` (L,), predicted `limits` (L, 3), `volume` (L,) [N/m N s/m kg], `free_db` (L,);
    `confirmed` by trials.

    `open_ends` lists where a grid was smaller than its set.
    """

    level: Floats
    limits: Floats
    volume: Floats
    free_db: Floats
    confirmed: tuple[Limit, ...]
    open_ends: tuple[str, ...]

    def gain(self, low: float, high: float) -> Floats:
        """Return the mean growth of the limits (3,) per N s/m between two levels."""
        at = [int(np.argmin(np.abs(self.level - each))) for each in (low, high)]
        return np.asarray(
            (self.limits[at[1]] - self.limits[at[0]]) / (self.level[at[1]] - self.level[at[0]])
        )


@dataclass(frozen=True, eq=False)
class SearchCheck:
    """The check at one active damping: `points` of the grid, `passive` of them. Wrong points:
    `predicted` by prediction alone, `other_noise` by the second grid, `searched` by n trials.
    `found` is the search with all of its trials.
    """

    active_damping_ns_per_m: float
    points: int
    passive: int
    predicted: int
    other_noise: int
    searched: dict[int, int]
    found: SearchResult

    @property
    def enough(self) -> int | None:
        """The first number of trials with at most as many wrong points as the floor; None if none
        did.
        """
        return next(
            (count for count, wrong in self.searched.items() if wrong <= self.other_noise), None
        )

    def share(self, wrong: int) -> float:
        """Return `wrong` points in percent of the passive ones."""
        return 100.0 * wrong / self.passive


CASES = (
    Case("off", 0.0),
    Case("on", ADDED_NS_PER_M),
    Case("on_negative_B", ADDED_NS_PER_M, negative=True),
    Case("off_negative_B", 0.0, negative=True),
    Case("off_safe", 0.0, dry=False),
    Case("on_safe", ADDED_NS_PER_M, dry=False),
    Case("on_negative_B_safe", ADDED_NS_PER_M, negative=True, dry=False),
)


@dataclass(frozen=True, eq=False)
class FutureWorkPlan:
    """The device, and the noise for all shown results; none: prediction alone."""

    bench: Bench
    seeds: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class FutureWorkResult:
    """`envelopes` by the name of their case; `passing_twice`: share of the low owners of an
    envelope that also pass at twice the force.
    """

    plan: FutureWorkPlan
    envelopes: dict[str, Bounds]
    passing_twice: dict[str, float]
    free: FreeMotion
    shaped: ShapedResult
    levels: DampingLevels
    searches: tuple[SearchCheck, ...]


def plan_future_work(quick: bool = False, seeds: int = SEEDS) -> FutureWorkPlan:
    """Return a plan with seeds 1, 2, ..., none if quick. ConfigError as for `load_scene`."""
    return FutureWorkPlan(Bench(conditions(MAIN)), () if quick else tuple(range(1, seeds + 1)))


def run_future_work(plan: FutureWorkPlan, tell: Progress = silent) -> FutureWorkResult:
    """Run the plan. ConfigError as for `simulate`."""
    bench = plan.bench
    seeds = plan.seeds
    steps = Steps(tell, len(CASES) + 3 + (len(LEVELS) if seeds else 0))
    envelopes = {}
    for case in CASES:
        steps.next(f"envelope, {case.name}")
        envelopes[case.name] = bounds_of(bench, case, seeds)
    passing = {
        name: passing_twice(bench, bounds, seeds[0]) for name, bounds in envelopes.items() if seeds
    }
    steps.next("free motion")
    free = free_motion(bench, ADDED_NS_PER_M, seeds)
    steps.next("shaped damping")
    shaped = shaped_damping(bench, ADDED_NS_PER_M, seeds)
    steps.next("levels of damping")
    levels = damping_levels(bench, seeds)
    searches = []
    for level in LEVELS if seeds else ():
        steps.next(f"directed search, {level:g} N s/m")
        searches.append(compared_with_grid(bench.conditions, level))
    steps.end()
    return FutureWorkResult(plan, envelopes, passing, free, shaped, levels, tuple(searches))


def mean_sd(runs: Floats) -> tuple[float, float]:
    """Return mean and standard deviation over seeds, the latter nan with less than two."""
    return float(np.mean(runs)), float(np.std(runs, ddof=1)) if len(runs) > 1 else float("nan")


def mean_db(frequency_hz: Floats, values: Floats, band_hz: tuple[float, float]) -> Floats:
    """Return the mean over ln f [dB] (N,) of `values` (N, F) at the frequencies inside the band."""
    return mean_over_ln_f(frequency_hz, 20.0 * np.log10(values), band_hz)


def candidates(bench: Bench, case: Case, points: Floats = GRID) -> Floats:
    """Return environments (N, 3) of the grid that are predicted to be passive in this case."""
    kept = points if case.negative else points[points[:, 1] >= 0.0]
    return np.asarray(kept[bench.display.passive(kept, case.level, dry=case.dry)])


def bounds_of(
    bench: Bench, case: Case, seeds: tuple[int, ...] = (), points: Floats = GRID
) -> Bounds:
    """Return bounds by trials of the owners, all of which pass with every seed; without seeds by
    prediction.
    """
    kept = candidates(bench, case, points)
    size = bench.sizes(kept, case.level)
    runs = size[None]
    passed = np.full(len(kept), True)
    counts = (0, 0)
    if seeds:
        runs, passed, counts = _excluding_failures(bench, case.level, kept, size, seeds)
    owners = _owners(size, passed)
    lower, upper = (np.take_along_axis(runs, which[None, None], 1)[:, 0] for which in owners)
    return Bounds(
        case,
        _edge(lower, owners[0]),
        _edge(upper, owners[1]),
        kept,
        lower,
        upper,
        size.min(axis=0),
        *counts,
    )


def _excluding_failures(
    bench: Bench, level: float, points: Floats, size: Floats, seeds: tuple[int, ...]
) -> tuple[Floats, Flags, tuple[int, int]]:
    """Try environments (N, 3) with predicted `size` (N, F), until all owners have passed with every
    seed. Return |Z| (seeds, N, F) by trials, nan without one; those (N,) that passed; the number of
    trials, and of failed environments.
    """
    every = np.full((len(seeds), *size.shape), np.nan)
    alive = np.full(len(points), True)
    tried = np.full(len(points), False)
    trials = 0
    for _ in range(ROUNDS):
        left = np.setdiff1d(np.concatenate(_owners(size, alive)), np.flatnonzero(tried))
        if not left.size:
            break
        tried[left] = True
        for row, seed in zip(every, seeds, strict=True):
            outcomes = bench.trials(points[left], level, seed) if left.size else []
            trials += len(outcomes)
            alive[left] = [outcome.passes for outcome in outcomes]
            for place, outcome in zip(left, outcomes, strict=True):
                row[place] = sizes(outcome) if outcome.passes else np.nan
            left = left[alive[left]]
    return every, alive & tried, (trials, int((~alive).sum()))


def passing_twice(bench: Bench, bounds: Bounds, seed: int, amplitude: float = 2.0) -> float:
    """Return the share of the owners of the lower edge in LOW_HZ that also pass with `amplitude`
    times the force.
    """
    low = (shown_hz() >= LOW_HZ[0]) & (shown_hz() <= LOW_HZ[1])
    points = bounds.points[np.unique(bounds.lower.owner[low])]
    return float(
        np.mean(
            [outcome.passes for outcome in bench.trials(points, bounds.case.level, seed, amplitude)]
        )
    )


def _owners(
    size: Floats, among: "np.ndarray[tuple[int], np.dtype[np.bool_]]"
) -> tuple[Integers, Integers]:
    """Return the owners of the minimum and the maximum predicted |Z| (F,)."""
    return np.where(among[:, None], size, np.inf).argmin(axis=0), np.where(
        among[:, None], size, -np.inf
    ).argmax(axis=0)


def _edge(runs: Floats, owner: Integers) -> Edge:
    spread = np.log(runs).std(axis=0, ddof=1) if len(runs) > 1 else np.zeros(runs.shape[1])
    return Edge(np.exp(np.log(runs).mean(axis=0)), spread, owner)


def free_motion(bench: Bench, level: float, seeds: tuple[int, ...]) -> FreeMotion:
    """Compare undamped with damped free motion, at `level` [N s/m]."""
    end = bench.limit(level, 1, FURTHEST)
    damping, _ = lightest_safe(bench, level, end, 0.0)
    both = lightest_safe(bench, level, end, -bench.display.model.mass_kg * 2.0)
    asked = (
        ("off", 0.0, 0.0, 0.0),
        ("on", level, 0.0, 0.0),
        ("on_negative_B", level, damping, 0.0),
        ("on_negative_BM", level, *both),
    )
    motions = tuple(_motion(bench, *each, seeds) for each in asked)
    downwards = bench.limits((0.0, level), seeds, (1,), (REACH[0], FURTHEST, REACH[2]))
    return FreeMotion(
        motions, downwards, _refusal(damping, bench.display.model.viscous_ns_per_m + level)
    )


def lightest_safe(
    bench: Bench, level: float, end: float, lightest_kg: float
) -> tuple[float, float]:
    """Return (B, M) of the lightest safe motion, B from `end` and M from `lightest_kg` up to 0."""
    masses = np.linspace(lightest_kg, 0.0, MASSES) if lightest_kg else np.zeros(1)
    points = grid((np.zeros(1), np.linspace(end, 0.0, DAMPINGS), masses))
    own = bench.display
    points = points[own.passive(points, level, dry=False)]
    points = points[lifted_passive(lifted_system(own.model, level, own.filters), points)]
    if not len(points):
        raise AnalysisError(
            f"{own.scene.name!r} at {level:g} N s/m: not passive without friction even for"
            " a free display"
        )
    best = points[mean_db(shown_hz(), bench.sizes(points, level), LOW_HZ).argmin()]
    return float(best[1]), float(best[2])


def _motion(
    bench: Bench, name: str, level: float, damping: float, mass_kg: float, seeds: tuple[int, ...]
) -> Motion:
    point = np.array([[0.0, damping, mass_kg]])
    outcomes = [outcome for seed in seeds for outcome in bench.trials(point, level, seed)]
    runs = np.array([sizes(outcome) for outcome in outcomes if outcome.passes]).reshape(
        -1, shown_hz().size
    )
    reserve = float(
        lifted_margin(lifted_system(bench.display.model, level, bench.display.filters), point)[0]
    )
    return Motion(name, level, damping, mass_kg, bench.sizes(point, level)[0], runs, reserve)


def _refusal(damping: float, physical: float) -> str:
    """Return the answer of the paper's Eq. 2 for B < 0."""
    try:
        paper_equation_2(0.0, damping, physical)
    except AnalysisError as refused:
        return str(refused)
    return ""


def shaped_damping(bench: Bench, level: float, seeds: tuple[int, ...]) -> ShapedResult:
    """Evaluate all corners at a damping level [N s/m] by prediction, the best one by trials."""
    undamped = corner(bench, 0.0)
    plain = corner(bench, level)
    highpass = tuple(corner(bench.shaped(highpass_hz=hertz), level, hertz) for hertz in HIGHPASS_HZ)
    lowpass = tuple(corner(bench.shaped(lowpass_hz=hertz), level, hertz) for hertz in LOWPASS_HZ)
    kept = [
        each for each in highpass if min(np.divide(each.limits, plain.limits)[1:]) >= 1.0 - KEPT
    ]
    best = min(kept, key=lambda each: each.free_db, default=plain)
    own = bench.shaped(highpass_hz=best.corner_hz) if best.corner_hz else bench
    stiffest = [float(predicted_set(each.display, level)[:, 0].max()) for each in (bench, own)]
    return ShapedResult(
        level,
        undamped,
        plain,
        highpass,
        lowpass,
        best,
        bounds_of(own, Case("on_shaped", level), seeds),
        own.limits((level,), seeds),
        _motion(own, "shaped", level, 0.0, 0.0, seeds),
        (stiffest[0], stiffest[1]),
    )


def corner(bench: Bench, level: float, corner_hz: float = 0.0) -> Corner:
    """Return the predictions for a display at an active damping [N s/m]; `corner_hz` is that of its
    damping, 0 for none.
    """
    limits = (bench.limit(level, 0), bench.limit(level, 1), bench.limit(level, 2))
    return Corner(
        corner_hz, limits, float(mean_db(shown_hz(), bench.sizes(FREE, level), LOW_HZ)[0])
    )


def damping_levels(bench: Bench, seeds: tuple[int, ...]) -> DampingLevels:
    """Evaluate all levels by prediction, TRIED_LEVELS by trials."""
    each = [corner(bench, level) for level in DAMPING_LEVELS]
    limits = np.array([one.limits for one in each])
    free = np.array([one.free_db for one in each])
    sets = [_set(bench, *one) for one in zip(DAMPING_LEVELS, limits, strict=True)]
    ends = [
        f"{end} at {level:g} N s/m"
        for level, (_, cut) in zip(DAMPING_LEVELS, sets, strict=True)
        for end in cut
    ]
    return DampingLevels(
        np.array(DAMPING_LEVELS), limits, np.array([size for size, _ in sets]), free,
        bench.limits(TRIED_LEVELS, seeds) if seeds else (), tuple(dict.fromkeys(ends)),
    )  # fmt: skip


def _set(bench: Bench, level: float, limits: Floats) -> tuple[float, tuple[str, ...]]:
    """Return the volume, and upper or lower ends at which the grid was too small; K and B begin at
    0 by definition.
    """
    k, b, m = limits * np.asarray(ROOM)
    axes = (
        np.linspace(0.0, k, STEPS[0]),
        np.linspace(0.0, b, STEPS[1]),
        np.linspace(m, -HEAVIEST * m + bench.display.model.mass_kg, STEPS[2]),
    )
    found = PassiveSet.of(axes, bench.display.predicted(grid(axes), level).decided_margin)
    return found.volume(), tuple(end for end in found.open_ends() if end not in ("K min", "B min"))


def compared_with_grid(
    conditions: Conditions,
    active_damping_ns_per_m: float,
    budgets: tuple[int, ...] = BUDGETS,
    tell: Progress = silent,
) -> SearchCheck:
    """Try the whole grid twice, and search once with `budgets[-1]` trials; the search with fewer
    trials is a part of that one.
    """
    params = MapParams(
        conditions, SEARCHED[active_damping_ns_per_m], (active_damping_ns_per_m,), everywhere=True
    )
    prediction = plan_map(params).levels[0].prediction
    noises = (*GRID_SEEDS, SEARCH_SEED)
    *grids, own = (
        conditions.perturbed(more_seed=seed - conditions.excitation.seed) for seed in noises
    )
    reference, again = (_passive(replace(params, conditions=given), tell) for given in grids)
    search = plan_search(SearchParams(own, active_damping_ns_per_m, budgets[-1], doubt=0.0))
    found = run_search(search, TrialStore(None), tell)
    searched = {}
    for count in budgets:  # the choice of trials does not depend on how many follow
        outcomes = [step.outcome for step in found.steps[:count]]
        known = search.begin.with_trials(
            [one.environment for one in outcomes], [observed(own, one) for one in outcomes]
        )
        searched[count] = int((predicted_passive(known, prediction.points) != reference).sum())
    predicted, floor = (int((other != reference).sum()) for other in (prediction.passive, again))
    return SearchCheck(
        active_damping_ns_per_m,
        reference.size,
        int(reference.sum()),
        predicted,
        floor,
        searched,
        found,
    )


def _passive(params: MapParams, tell: Progress) -> Flags:
    return run_map(plan_map(params), TrialStore(None), tell).levels[0].found.passive.ravel()
