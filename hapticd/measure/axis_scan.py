"""Axis limits by trials: one of K, B, M from 0 to its first failure, the others 0, as the paper's headline numbers read.

The prediction says where to look: a first round of 16 trials about it, further rounds outwards as long as none or all fail,
then 16 more between the last that passed and the first that failed. The limit is the last value before the first failure by
the paper's rule; below `lower` every verdict was passive at the confidence asked, at `upper` one was not passive.

Limits belong to a perturbation: with Coulomb friction they fall as it grows. `amplitudes` scans several, each a factor of the
scene's force. `seeds` repeats the whole scan with other noise; the scatter is given beside the mean.

Outcomes go to the append-only store of all campaigns: limits that were interrupted, or are asked again with more seeds, levels or
amplitudes, make only the trials that are missing.
"""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import product
from math import nan

import numpy as np

from hapticd.analysis.boundary import AXES, axis_limit
from hapticd.measure.bracketing import REACH, Bracketing, Fly, Scan, bracket, bracket_all
from hapticd.measure.executors import pool_of
from hapticd.measure.outcomes import Conditions, Outcome, fly, predictor
from hapticd.measure.progress import Progress, silent
from hapticd.measure.store import TrialStore

Hear = Callable[[Scan, Conditions, list[Outcome]], None]


@dataclass(frozen=True, slots=True)
class LimitsParams:
    """`levels`: of electrical damping [Ns/m]; `amplitudes`: factors of the perturbation's force."""

    conditions: Conditions
    levels: tuple[float, ...] = (0.0, 1.74)
    amplitudes: tuple[float, ...] = (1.0,)
    axes: tuple[int, ...] = (0, 1, 2)
    seeds: int = 1


@dataclass(frozen=True, slots=True)
class LimitsPlan:
    """All of them, each with its prediction."""

    params: LimitsParams
    scans: tuple[Scan, ...]


@dataclass(frozen=True, slots=True)
class AxisLimit:
    """`value` [N/m, Ns/m, kg]: mean over seeds, `sd` their scatter (nan for one); `lower`, `upper`: widest over seeds.

    `worst_hz`: where the first failure has its least Re Z; `velocity_sd` [m/s] of the last trial that passed.
    """

    scan: Scan
    value: float
    lower: float
    upper: float
    sd: float
    worst_hz: float
    velocity_sd: float
    perturbation_psd: float
    trials: int

    @property
    def name(self) -> str:
        """K, B or M."""
        return AXES[self.scan.axis]


@dataclass(frozen=True, slots=True)
class LimitsResult:
    """In the order of the plan. `made` trials were new, the rest came from the store."""

    plan: LimitsPlan
    limits: tuple[AxisLimit, ...]
    made: int


def plan_limits(params: LimitsParams) -> LimitsPlan:
    """Predict every limit. ConfigError as `compose`."""
    scans = [
        Scan(axis, level, amplitude, _predicted(params, axis, level, amplitude))
        for level, amplitude, axis in product(params.levels, params.amplitudes, params.axes)
    ]
    return LimitsPlan(params, tuple(scans))


def run_limits(
    plan: LimitsPlan, store: TrialStore, tell: Progress = silent, executor: Executor | None = None,
    hear: Hear = lambda scan, conditions, new: None, flying: Fly = fly,
) -> LimitsResult:  # fmt: skip
    """Find them all by the trials that the store has not, on `executor` or on threads here; `hear` gets those of each round.

    KeyboardInterrupt passes through after the rounds in flight were given up; what was finished is in the store.
    """
    params, ended, made = plan.params, 0, 0
    wanted = [Bracketing(scan, _at(params, scan.amplitude, repeat)) for scan in plan.scans for repeat in range(params.seeds)]

    def told(one: Bracketing, new: list[Outcome], last: bool) -> None:
        nonlocal ended, made
        ended, made = ended + last, made + len(new)
        tell("axis limits", ended, len(wanted))
        if new:
            hear(one.scan, one.conditions, new)

    tell("axis limits", 0, len(wanted))
    with pool_of(executor) as pool:
        bracket_all(wanted, store, pool, flying, told)
    tried = [[one.tried for one in wanted if one.scan is scan] for scan in plan.scans]
    found = tuple(_together(params, scan, seeds) for scan, seeds in zip(plan.scans, tried, strict=True))
    return LimitsResult(plan, found, made)


def _at(params: LimitsParams, amplitude: float, repeat: int = 0) -> Conditions:
    source = params.conditions.excitation
    changed = replace(source, psd_n2_per_hz=source.psd_n2_per_hz * amplitude**2, seed=source.seed + repeat)
    return replace(params.conditions, excitation=changed)


def _predicted(params: LimitsParams, axis: int, level: float, amplitude: float) -> float:
    guess = predictor(_at(params, amplitude), level)
    return axis_limit(lambda points: guess(points).passive, axis, REACH[axis])


def _together(params: LimitsParams, scan: Scan, seeds: list[list[Outcome]]) -> AxisLimit:
    values = np.array([bracket(scan.axis, tried)[0] for tried in seeds])
    sure = [_first(scan.axis, tried, "passive", stop=True) for tried in seeds]
    never = [_first(scan.axis, tried, "not_passive", stop=False) for tried in seeds]
    failed = next((outcome for outcome in seeds[0] if not outcome.passes), None)
    passed = [outcome for outcome in seeds[0] if abs(outcome.environment[scan.axis]) <= abs(values[0])]
    sense = -1.0 if REACH[scan.axis] < 0.0 else 1.0
    return AxisLimit(
        scan=scan,
        value=float(values.mean()),
        lower=sense * min((sense * value for value in sure), default=nan),
        upper=sense * max((sense * value for value in never), default=nan),
        sd=float(values.std(ddof=1)) if len(values) > 1 else nan,
        worst_hz=failed.worst_hz if failed else nan,
        velocity_sd=passed[-1].velocity_sd if passed else nan,
        perturbation_psd=_at(params, scan.amplitude).excitation.psd_n2_per_hz,
        trials=sum(map(len, seeds)),
    )


def _first(axis: int, tried: list[Outcome], answer: str, stop: bool) -> float:
    """With `stop` the last value up to which all have this answer, else the first that has it."""
    last = 0.0 if stop else nan
    for outcome in tried:
        if outcome.answer == answer:
            last = outcome.environment[axis]
            if not stop:
                return last
        elif stop:
            break
    return last
