"""Limits along axes by trials: how far one of K, B, M goes from a base point, its first failure
being the end.

The paper's headline numbers are those from K = B = M = 0; from where the other two stand at their
best it is the maximum over the set. All limits are searched for here: those of a table, the
paper's, those of its band edges, and those of a scene with an effect left out.

The prediction says where to look: a first round of trials about it, further rounds outwards as long
as none or all fail, then between the last that passed and the first that failed, until the limit is
known to `tolerance`. A round is one task; what the next one is depends on the one before. The limit
is the last value before the first failure by the paper's rule; below `lower` every verdict was
passive at the confidence asked, at `upper` one was not passive.

Limits belong to a perturbation: with Coulomb friction they fall as it grows. `amplitudes` scans
several, each a factor of the scene's force. `seeds` repeats the whole scan with other noise; the
scatter is given beside the mean. A lower band edge is one of the conditions.

Outcomes go to an append-only store: limits that were interrupted, or are asked for again with more
seeds, levels or amplitudes, run only the trials that are missing.

Limitations: a set that is not in one piece along the line that is searched.
"""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import islice, product, takewhile
from math import isfinite, nan
from typing import Any

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.signal.passive_set import AXES, axis_limit
from hapticd.signal.verdict import NOTHING_JUDGED, Judged
from hapticd.zwidth.outcomes import (
    Conditions,
    Outcome,
    Point,
    Procedure,
    TrialBatch,
    judged,
    points_of,
    run_all,
)
from hapticd.zwidth.scenes import Display
from hapticd.zwidth.store import Progress, TrialStore, silent

__all__ = [
    "ORIGIN",
    "REACH",
    "AxisLimit",
    "LimitsParams",
    "LimitsPlan",
    "LimitsResult",
    "Scan",
    "plan_limits",
    "predicted_limit",
    "run_limits",
    "run_plans",
]

ORIGIN: Point = (0.0, 0.0, 0.0)
REACH = (2e4, 60.0, -0.25)  # of a predicted search: N/m, Ns/m, kg
FIRST = (0.6, 1.5)  # of the predicted distance: where the first round looks
OUTWARDS = 2.5  # factor by which a round in which all pass is extended
ROUNDS = 6  # at most, after the first
ROUND = 32  # values: the engine takes no longer for them together than for one
UNPREDICTED = 0.02  # of the reach, where the prediction has no limit to look near


@dataclass(frozen=True, slots=True)
class LimitsParams:
    """`levels`: of active damping [Ns/m]; `amplitudes`: factors of the perturbation's force.
    `axes` are 0 K, 1 B, 2 M, each scanned from `base` towards `reach` [N/m, Ns/m, kg] beyond it;
    `tolerance`: of a limit, 0.01 is 1 %.
    """

    conditions: Conditions
    levels: tuple[float, ...] = (0.0, 1.74)
    amplitudes: tuple[float, ...] = (1.0,)
    axes: tuple[int, ...] = (0, 1, 2)
    seeds: int = 1  # repetitions with other noise
    base: Point = ORIGIN  # N/m, N s/m, kg
    reach: tuple[float, float, float] = REACH
    tolerance: float = 0.01


@dataclass(frozen=True, slots=True)
class Scan:
    """One limit to be found; `predicted` nan where even the base is not passive."""

    axis: int  # 0 K, 1 B, 2 M
    active_damping_ns_per_m: float  # active damping
    amplitude: float  # factor of the perturbation's force
    predicted: float  # N/m, N s/m or kg


@dataclass(frozen=True, slots=True)
class LimitsPlan:
    """All limits that are asked for, each with its prediction."""

    params: LimitsParams
    scans: tuple[Scan, ...]


@dataclass(frozen=True, slots=True)
class AxisLimit:
    """`value` [N/m, Ns/m, kg]: mean over seeds, `sd` their scatter (nan for one); `lower`, `upper`:
    widest over seeds; `values` those of each seed, nan where the base fails; `judged`: from where
    to where all trials were.

    `worst_hz`: where the first failure has its least Re Z; `velocity_sd` [m/s] of the last trial
    that passed.
    """

    scan: Scan
    value: float
    lower: float
    upper: float
    sd: float
    worst_hz: float
    velocity_sd: float
    perturbation_psd: float  # N^2/Hz, one-sided
    trials: int  # of all seeds
    values: tuple[float, ...]
    judged: Judged = NOTHING_JUDGED

    @property
    def name(self) -> str:
        """K, B or M."""
        return AXES[self.scan.axis]


@dataclass(frozen=True, slots=True)
class LimitsResult:
    """In the order of the plan. `made` trials, of all plans side by side, were new; the rest
    came from the store.
    """

    plan: LimitsPlan
    limits: tuple[AxisLimit, ...]
    made: int


OnRound = Callable[[Scan, Conditions, list[Outcome]], None]


def predicted_limit(
    device: Display,
    level: float,
    axis: int,
    base: Point = ORIGIN,
    band_hz: tuple[float, float] | None = None,
    reach: float | None = None,
) -> float:
    """The first failure by prediction, from `base` on towards `reach`; nan where even the base
    is not passive.
    """
    band = () if band_hz is None else (band_hz,)
    return axis_limit(
        lambda points: device.passive(points, level, *band), axis, reach or REACH[axis], base
    )


def plan_limits(params: LimitsParams) -> LimitsPlan:
    """Predict every limit. ConfigError as `compose`."""
    scans = []
    for level, amplitude, axis in product(params.levels, params.amplitudes, params.axes):
        perturbed = params.conditions.perturbed(amplitude)
        near = predicted_limit(
            perturbed.display, level, axis, params.base, perturbed.band_hz, params.reach[axis]
        )
        scans.append(Scan(axis, level, amplitude, near))
    return LimitsPlan(params, tuple(scans))


def run_limits(
    plan: LimitsPlan, store: TrialStore, tell: Progress = silent, executor: Executor | None = None,
    on_outcomes: OnRound = lambda scan, conditions, new: None,
) -> LimitsResult:  # fmt: skip
    """Find all limits; trials that the store lacks run on `executor` or on threads of this process.
    `on_outcomes` receives the new outcomes of each round.

    KeyboardInterrupt passes through after the rounds under way were cancelled; what was finished is
    in the store.
    """
    return run_plans([plan], store, tell, executor, on_outcomes)[0]


def run_plans(
    plans: Sequence[LimitsPlan],
    store: TrialStore,
    tell: Progress = silent,
    executor: Executor | None = None,
    on_outcomes: OnRound = lambda scan, conditions, new: None,
) -> tuple[LimitsResult, ...]:
    """Several plans side by side."""
    wanted = [
        (plan.params, scan, plan.params.conditions.perturbed(scan.amplitude, repeat))
        for plan in plans for scan in plan.scans for repeat in range(plan.params.seeds)
    ]  # fmt: skip
    ended = made = 0

    def counted(*given: Any) -> Procedure[list[Outcome]]:
        nonlocal ended
        tried = yield from search_limit(*given)
        ended += 1
        tell("axis limits", ended, len(wanted))
        return tried

    def on_batch(place: int, batch: TrialBatch, new: list[Outcome]) -> None:
        nonlocal made
        made += len(new)
        on_outcomes(wanted[place][1], batch.conditions, new)

    tell("axis limits", 0, len(wanted))
    tried = iter(run_all([counted(*each) for each in wanted], store, executor, on_batch))
    return tuple(
        LimitsResult(
            plan,
            tuple(
                _together(plan.params, scan, [*islice(tried, plan.params.seeds)])
                for scan in plan.scans
            ),
            made,
        )
        for plan in plans
    )


def search_limit(
    params: LimitsParams, scan: Scan, conditions: Conditions
) -> Procedure[list[Outcome]]:
    """All trials of a scan under one noise, in order of the axis."""
    tried: list[Outcome] = []
    begin = params.base[scan.axis]
    for values in _rounds(params, scan, tried):
        points = np.tile(params.base, (len(values), 1))
        points[:, scan.axis] = begin + values
        tried += yield [TrialBatch(conditions, scan.active_damping_ns_per_m, points_of(points))]
        tried.sort(key=lambda outcome: abs(outcome.environment[scan.axis] - begin))
    return tried


def _rounds(params: LimitsParams, scan: Scan, tried: list[Outcome]) -> Iterable[Floats]:
    """Distances from the base to try next; `tried` grows meanwhile."""
    begin = params.base[scan.axis]
    near = scan.predicted - begin
    if not isfinite(near) or near == 0.0:
        near = UNPREDICTED * params.reach[scan.axis]
    low = FIRST[0] * near
    high = FIRST[1] * near
    yield np.concatenate(([0.0], np.linspace(low, high, ROUND - 1)))
    for _ in range(ROUNDS):
        passed, failed = (value - begin for value in bracket(scan.axis, tried))
        if np.isnan(passed):
            return
        if np.isnan(failed):
            yield np.linspace(passed, OUTWARDS * passed if passed else high, ROUND + 1)[1:]
        elif abs(failed - passed) > params.tolerance * abs(failed):
            yield np.linspace(passed, failed, ROUND + 2)[1:-1]
        else:
            return


def bracket(axis: int, tried: list[Outcome]) -> tuple[float, float]:
    """Last value that passed before the first that failed, and that; nan where there is none."""
    values = [outcome.environment[axis] for outcome in tried]
    count = len(list(takewhile(lambda outcome: outcome.passes, tried)))
    return next(iter(values[:count][-1:]), nan), next(iter(values[count:]), nan)


def _together(params: LimitsParams, scan: Scan, seeds: list[list[Outcome]]) -> AxisLimit:
    axis = scan.axis
    begin = params.base[scan.axis]
    values = np.array([bracket(axis, tried)[0] for tried in seeds])
    sure = [
        [begin, *(one.environment[axis] for one in takewhile(_surely_passive, tried))][-1]
        for tried in seeds
    ]
    never = [
        next((one.environment[axis] for one in tried if one.answer == "not_passive"), nan)
        for tried in seeds
    ]
    failed = next((outcome for outcome in seeds[0] if not outcome.passes), None)
    passed = [
        outcome
        for outcome in seeds[0]
        if abs(outcome.environment[axis] - begin) <= abs(values[0] - begin)
    ]
    sense = -1.0 if params.reach[axis] < 0.0 else 1.0
    return AxisLimit(
        scan=scan,
        value=float(values.mean()),
        lower=sense * min((sense * value for value in sure), default=nan),
        upper=sense * max((sense * value for value in never), default=nan),
        sd=float(values.std(ddof=1)) if len(values) > 1 else nan,
        worst_hz=failed.worst_hz if failed else nan,
        velocity_sd=passed[-1].velocity_sd if passed else nan,
        perturbation_psd=params.conditions.perturbed(scan.amplitude).excitation.psd_n2_per_hz,
        trials=sum(map(len, seeds)),
        values=tuple(values.tolist()),
        judged=judged(one for tried in seeds for one in tried),
    )


def _surely_passive(outcome: Outcome) -> bool:
    return outcome.answer == "passive"
