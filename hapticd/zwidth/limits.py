"""Limits along axes by trials: the first failure of one of K, B, M from a base point.

The paper's headline numbers start from K = B = M = 0. From the best values of the other two, the
limit is the maximum over the set. All limits are searched for here: those of a table, the paper's,
those of its band edges, and those of a scene without an effect.

A first round of trials covers the predicted limit. Further rounds go outwards as long as none or
all fail, then between the last that passed and the first that failed, until the limit is known to
`tolerance`. A round is one task, and each round depends on the one before. The limit is the last
value before the first failure by the paper's rule. Below `lower` every verdict was passive at the
given confidence; at `upper` one was not passive.

Limits belong to a perturbation: with Coulomb friction they fall as it grows. `amplitudes` scans
several, each a factor of the scene's force. `seeds` repeats the whole scan with other noise; the
scatter is given with the mean. A lower band edge is one of the conditions.

Outcomes go to an append-only store. If limits are interrupted, or requested again with more seeds,
levels or amplitudes, only the missing trials run.

Limitations: a set that is not in one piece along the line of the search.
"""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from itertools import islice, product, takewhile
from math import isfinite, nan
from typing import Any

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.signal.verdict import Judged
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
from hapticd.zwidth.passive_set import AXES, axis_limit
from hapticd.zwidth.sources import Display
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
FIRST = (0.6, 1.5)  # of the predicted distance: range of the first round
OUTWARDS = 2.5  # factor by which a round in which all pass is extended
ROUNDS = 6  # at most, after the first
ROUND = 32  # values: the engine takes as long for one as for all of them together
UNPREDICTED = 0.02  # of the reach, if the prediction has no limit


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
    """One limit to find; `predicted` is nan if even the base is not passive."""

    axis: int  # 0 K, 1 B, 2 M
    active_damping_ns_per_m: float  # active damping
    amplitude: float  # factor of the perturbation's force
    predicted: float  # N/m, N s/m or kg


@dataclass(frozen=True, slots=True)
class LimitsPlan:
    """All requested limits, each with its prediction."""

    params: LimitsParams
    scans: tuple[Scan, ...]


@dataclass(frozen=True, slots=True)
class AxisLimit:
    """A limit on one axis.

    `value` [N/m, Ns/m, kg]: mean over seeds, `sd` their scatter (nan for one); `lower`, `upper`:
    widest over seeds; `values` those of each seed, nan where the base fails; `judged`: the range of
    frequencies judged in all trials. `worst_hz`: frequency of minimum Re Z of the first failure;
    `velocity_sd` [m/s] of the last trial that passed.
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
    judged: Judged = field(default_factory=Judged)

    @property
    def name(self) -> str:
        """K, B or M."""
        return AXES[self.scan.axis]


@dataclass(frozen=True, slots=True)
class LimitsResult:
    """The limits in the order of the plan. `made` trials, over all plans run together, were new;
    the rest came from the store.
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
    """Return the predicted first failure from `base` towards `reach`; nan if even the base is not
    passive.
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
    """Find all limits; trials missing from the store run on `executor` or on threads of this
    process. `on_outcomes` receives the new outcomes of each round.

    KeyboardInterrupt propagates after the running rounds were cancelled; finished trials are in the
    store.
    """
    return run_plans([plan], store, tell, executor, on_outcomes)[0]


def run_plans(
    plans: Sequence[LimitsPlan],
    store: TrialStore,
    tell: Progress = silent,
    executor: Executor | None = None,
    on_outcomes: OnRound = lambda scan, conditions, new: None,
) -> tuple[LimitsResult, ...]:
    """Run several plans together."""
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
    """Return all trials of a scan under one noise, in order of the axis."""
    tried: list[Outcome] = []
    begin = params.base[scan.axis]
    for values in _rounds(params, scan, tried):
        points = np.tile(params.base, (len(values), 1))
        points[:, scan.axis] = begin + values
        tried += yield [TrialBatch(conditions, scan.active_damping_ns_per_m, points_of(points))]
        tried.sort(key=lambda outcome: abs(outcome.environment[scan.axis] - begin))
    return tried


def _rounds(params: LimitsParams, scan: Scan, tried: list[Outcome]) -> Iterable[Floats]:
    """Yield distances from the base to try next; `tried` grows meanwhile."""
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
    """Return the last value that passed before the first that failed, and that failure; nan if
    there is none.
    """
    values = [outcome.environment[axis] for outcome in tried]
    count = len(list(takewhile(lambda outcome: outcome.passes, tried)))
    return next(iter(values[:count][-1:]), nan), next(iter(values[count:]), nan)


def _together(params: LimitsParams, scan: Scan, seeds: list[list[Outcome]]) -> AxisLimit:
    axis = scan.axis
    begin = params.base[scan.axis]
    values = np.array([bracket(axis, tried)[0] for tried in seeds])
    sure = [
        [
            begin,
            *(
                one.environment[axis]
                for one in takewhile(lambda one: one.answer == "passive", tried)
            ),
        ][-1]
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
