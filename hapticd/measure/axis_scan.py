"""Axis limits by trials: one of K, B, M from 0 to its first failure, the others 0, as the paper's headline numbers read.

The prediction says where to look: a first round of 16 trials about it, further rounds outwards as long as none or all fail,
then 16 more between the last that passed and the first that failed. The limit is the last value before the first failure by
the paper's rule; below `lower` every verdict was passive at the confidence asked, at `upper` one was not passive.

Limits belong to a perturbation: with Coulomb friction they fall as it grows. `amplitudes` scans several, each a factor of the
scene's force. `seeds` repeats the whole scan with other noise; the scatter is given beside the mean.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from math import nan

import numpy as np

from hapticd.analysis.arrays import Flags, Floats
from hapticd.analysis.boundary import AXES, axis_limit
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.predict import predict
from hapticd.measure.outcomes import TOGETHER, Conditions, Outcome, fly
from hapticd.measure.progress import Progress, Steps, silent
from hapticd.measure.scenes import filters
from hapticd.plant.compose import compose
from hapticd.plant.model import Model

REACH = (2e4, 60.0, -0.25)  # of a predicted search: N/m, Ns/m, kg
FIRST = (0.6, 1.5)  # of the predicted limit: where the first round looks
OUTWARDS = 2.5
ROUNDS = 5
COARSE = 0.15  # of the limit: a step that one more round makes fine enough
UNPREDICTED = 0.02  # of the reach, where the prediction has no limit to look near

Fly = Callable[[Conditions, float, Floats], list[Outcome]]


@dataclass(frozen=True, slots=True)
class LimitsParams:
    """`levels`: of electrical damping [Ns/m]; `amplitudes`: factors of the perturbation's force."""

    conditions: Conditions
    levels: tuple[float, ...] = (0.0, 1.74)
    amplitudes: tuple[float, ...] = (1.0,)
    axes: tuple[int, ...] = (0, 1, 2)
    seeds: int = 1


@dataclass(frozen=True, slots=True)
class Scan:
    """One limit to be found."""

    axis: int
    damping_ns_per_m: float
    amplitude: float
    predicted: float


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
    """In the order of the plan."""

    plan: LimitsPlan
    limits: tuple[AxisLimit, ...]


def plan_limits(params: LimitsParams) -> LimitsPlan:
    """Predict every limit. ConfigError as `compose`."""
    model = compose(params.conditions.scene)
    scans = [
        Scan(axis, level, amplitude, _predicted(params, model, axis, level, amplitude))
        for level, amplitude, axis in product(params.levels, params.amplitudes, params.axes)
    ]
    return LimitsPlan(params, tuple(scans))


def run_limits(plan: LimitsPlan, tell: Progress = silent, flying: Fly = fly) -> LimitsResult:
    """Find them all by trials."""
    steps = Steps(tell, len(plan.scans) * plan.params.seeds)
    found = []
    for scan in plan.scans:
        seeds = []
        for repeat in range(plan.params.seeds):
            steps.next(f"{AXES[scan.axis]} limit, damping {scan.damping_ns_per_m:g} N s/m")
            seeds.append(_scanned(_at(plan.params, scan.amplitude, repeat), scan, flying))
        found.append(_together(plan.params, scan, seeds))
    steps.end()
    return LimitsResult(plan, tuple(found))


def _at(params: LimitsParams, amplitude: float, repeat: int = 0) -> Conditions:
    source = params.conditions.excitation
    changed = replace(source, psd_n2_per_hz=source.psd_n2_per_hz * amplitude**2, seed=source.seed + repeat)
    return replace(params.conditions, excitation=changed)


def _predicted(params: LimitsParams, model: Model, axis: int, level: float, amplitude: float) -> float:
    conditions = _at(params, amplitude)
    source = Perturbation(conditions.excitation.psd_n2_per_hz, conditions.excitation.band_hz)
    chosen = filters(conditions.scene)

    def decide(points: Floats) -> Flags:
        return predict(model, points, level, chosen, source, conditions.band_hz).passive

    return axis_limit(decide, axis, REACH[axis])


def _rounds(scan: Scan, tried: list[Outcome]) -> Iterator[Floats]:
    """Values to try next, round by round, until the limit is known to 1 %."""
    near = scan.predicted if np.isfinite(scan.predicted) and scan.predicted != 0.0 else UNPREDICTED * REACH[scan.axis]
    low, high = FIRST[0] * near, FIRST[1] * near
    yield np.concatenate(([0.0], np.linspace(low, high, TOGETHER - 1)))
    for _ in range(ROUNDS):
        passed, failed = _bracket(scan.axis, tried)
        if np.isnan(passed):
            return
        if np.isnan(failed):
            yield np.linspace(passed, OUTWARDS * passed if passed else high, TOGETHER + 1)[1:]
        elif abs(failed - passed) > COARSE * abs(failed):
            yield np.linspace(passed, failed, TOGETHER + 2)[1:-1]
        else:
            break
    passed, failed = _bracket(scan.axis, tried)
    if np.isfinite(passed) and np.isfinite(failed):
        yield np.linspace(passed, failed, TOGETHER + 2)[1:-1]


def _scanned(conditions: Conditions, scan: Scan, flying: Fly) -> list[Outcome]:
    tried: list[Outcome] = []
    for values in _rounds(scan, tried):
        points = np.zeros((len(values), 3))
        points[:, scan.axis] = values
        tried += flying(conditions, scan.damping_ns_per_m, points)
        tried.sort(key=lambda outcome: abs(outcome.environment[scan.axis]))
    return tried


def _bracket(axis: int, tried: list[Outcome]) -> tuple[float, float]:
    """Last value that passed before the first that failed, and that; nan where there is none."""
    failed = next((place for place, outcome in enumerate(tried) if not outcome.passes), None)
    last = (tried if failed is None else tried[:failed])[-1:]
    return (
        last[0].environment[axis] if last else nan,
        nan if failed is None else tried[failed].environment[axis],
    )


def _together(params: LimitsParams, scan: Scan, seeds: list[list[Outcome]]) -> AxisLimit:
    values = np.array([_bracket(scan.axis, tried)[0] for tried in seeds])
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
