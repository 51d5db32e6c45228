"""The effects that a question needs: leaves them out one at a time, compares the answers, and
proposes the cheapest set that gives the answer of the whole scene.

Linear effects are judged by prediction, which has no noise, others by simulation. Effects that
alone change the answer by less than the tolerance are then left out together, the least important
first, as long as prediction agrees. The rest is simulated against the whole scene, and the most
important omitted effect is restored until that agrees as well.

A set of effects is judged by one quantity, predicted (first harmonic, friction linearised: no
noise) and simulated (the engine, with the same perturbation for every set of effects, so that
differences are those of the effects):

    limits   of K, B and M, each from 0 (`zwidth.limits`); change: the largest relative one
    phase    of Z under the scene's environment; change: the largest difference in the band over 90
             degrees
    peak     highest |Z| between 40 and 200 Hz near the most negative passive mass, which owns the
             peak of Weir 2008, Fig. 8, and its frequency; change: the larger relative one of the
             two

A scene without noise gets the paper's perturbation. Walls are left out, because they have no
impedance of their own.

Answers must be simulated with the same perturbations: their difference is otherwise chance.

Cost (`cost`). The command line passes the processor time of this process (`time.process_time_ns`)
as the clock: seconds of one core, whatever else the machine does. The timed code runs on one
thread. The engine computes a group of trials with every instruction, so the cost of a trial is its
share of a full group.

Limitations: effects that mask each other, which is why the proposal is simulated as a whole.
"""

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from math import inf, nan
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Complexes, Floats
from hapticd.core.errors import AnalysisError, ConfigError
from hapticd.core.units import NS_PER_S, PROBE_RATE_HZ
from hapticd.model.predict import predicted_impedance
from hapticd.model.scene import Scene
from hapticd.run.lockstep import LockStep, scene_params
from hapticd.signal.spectra import DEFAULT_LAG, Spectra, spa
from hapticd.zwidth.engine.batch import BatchResult, simulate
from hapticd.zwidth.engine.shape import LANES
from hapticd.zwidth.limits import LimitsParams, plan_limits, run_limits
from hapticd.zwidth.outcomes import Conditions
from hapticd.zwidth.sources import SATURATED, display, frequencies
from hapticd.zwidth.store import Progress, Steps, TrialStore, silent

__all__ = ["EffectsParams", "cost", "plan_effects", "run_effects"]

# --- the cost of a simulated second ---------------------------------------------------------------

T = TypeVar("T")
Stopwatch = Callable[[], int]  # processor time so far [ns]
COST_ENGINE_S = 4.0  # simulated, to time the engine
REPEATS = 9  # the fastest counts: other programs only slow it down
ALONE_REPEATS = 3
COST_LOCKSTEP_S = 0.5  # simulated, to time the stack in lock-step
SETTLING_TICKS = 100  # of a lock-step stack, before it is timed
GROUP = LANES["f64"]  # trials of a full group where sums alone are kept


def timed(now_ns: Stopwatch, call: Callable[[], T], times: int = 1) -> tuple[T, float]:
    """Return (result of `call`, seconds) of the fastest of `times` calls, the least disturbed."""

    def once() -> tuple[T, float]:
        begin_ns = now_ns()
        return call(), (now_ns() - begin_ns) / NS_PER_S

    return min((once() for _ in range(times)), key=lambda run: run[1])


@dataclass(frozen=True, slots=True)
class Cost:
    """Seconds of one core per simulated second."""

    engine_s: float  # of one trial in a full group
    lanes: int  # trials of a full group
    lockstep_s: float  # of the whole stack


def engine_cost(scene: Scene, now_ns: Stopwatch) -> float:
    """Return seconds per simulated second of one trial in a full group. The kernel is compiled
    before. ConfigError as `simulate`.
    """
    group = [scene.environment.free] * GROUP
    simulate(scene, group, 1.0 / scene.rate_hz)
    _, spent = timed(now_ns, lambda: simulate(scene, group, COST_ENGINE_S), REPEATS)
    return spent / (COST_ENGINE_S * GROUP)


def cost(scene: Scene, source: str | Path, now_ns: Stopwatch) -> Cost:
    """Measure the cost of the engine, and of the whole stack with the device on the simulated board
    and nothing enabled; `source` is the scene's name or file.
    """
    servo, board = scene_params(source)
    ticks = round(COST_LOCKSTEP_S * servo.realtime.rate_hz)
    with LockStep(servo, board, keep=False) as stack:
        stack.run(SETTLING_TICKS)
        _, spent = timed(now_ns, lambda: stack.run(ticks), ALONE_REPEATS)
    return Cost(engine_cost(scene, now_ns), GROUP, spent / COST_LOCKSTEP_S)


# --- spectra of trials ----------------------------------------------------------------------------


def spectra_on(
    torque_n: npt.ArrayLike,
    velocity_m_per_s: npt.ArrayLike,
    frequency_hz: Floats,
    lag: int = DEFAULT_LAG,
) -> Spectra:
    """Return spectra of a record at `frequency_hz` (F,), from the whole grid of its window if that
    contains them.
    """
    if lag % DEFAULT_LAG:
        return spa(torque_n, velocity_m_per_s, lag=lag, frequency_hz=frequency_hz)
    at = np.rint(frequency_hz * (2 * lag / PROBE_RATE_HZ)).astype(int)
    return spa(torque_n, velocity_m_per_s, lag=lag).part(at)


def spectra_of(
    found: BatchResult,
    frequency_hz: Floats,
    force_limit_n: float,
    lag: int = DEFAULT_LAG,
) -> list[Spectra]:
    """Return spectra at `frequency_hz` (F,) of every trial that ran to its end without reaching the
    force limit; the others ran away and have no impedance.
    """
    calm = ~found.diverged & (found.max_force_n < SATURATED * force_limit_n)
    return [spectra_on(*found.record(int(one)), frequency_hz, lag) for one in np.flatnonzero(calm)]


def pooled(trials: list[Spectra]) -> Complexes:
    """Return Z (F,) of several trials together, from summed spectra. AnalysisError without
    trials.
    """
    if not trials:
        raise AnalysisError("not stable: no trial ran to its end, so there is no impedance")
    return np.asarray(
        sum(trial.cross for trial in trials) / sum(trial.velocity for trial in trials)
    )


# --- questions ------------------------------------------------------------------------------------

PREDICTED = "predicted"
SIMULATED = "simulated"
PEAK_HZ = (40.0, 200.0)
LIMITS = {"K N/m": 1.0, "B N s/m": 1.0, "M g": 1e3}  # factors from SI units
PEAK = {"peak N s/m": 1.0, "at Hz": 1.0}
FINE = 1e-3  # relative error of a limit: a change of 1 % must be seen
INSIDE = 0.9  # of the predicted mass limit, for the peak: near it a long trial may run away
# relative change, 0.02 is 2 %, inf if only one of two numbers exists; numbers by name
Compared = tuple[float, dict[str, float]]


@dataclass(frozen=True, slots=True)
class EffectsParams:
    """The scene with all its effects, and the question."""

    scene: Scene
    question: str = "limits"  # one of QUESTIONS
    tolerance: float = 0.02  # a relative change below it does not matter
    seconds: float = 90.0  # length of a simulated trial


@dataclass(frozen=True, slots=True)
class Question:
    """The evaluation of one question.

    `values`: the numbers for a scene with some of its effects, PREDICTED or SIMULATED. `compare`
    returns the change of such numbers from those of the whole scene, and the numbers by name with
    unit.
    """

    values: Callable[[EffectsParams, Scene, str], Floats]
    compare: Callable[[Floats, Floats], Compared]


def impedance(
    params: EffectsParams,
    scene: Scene,
    kbm: tuple[float, float, float],
    frequency_hz: Floats,
    method: str,
) -> Complexes:
    """Return Z (F,) [N s/m] under one environment: predicted, or of a group of trials together."""
    own = display(scene, params.scene.noise)
    if method == PREDICTED:
        return predicted_impedance(
            own.model, kbm, frequency_hz, scene.level_ns_per_m, own.filters, own.perturbation
        )
    found = simulate(
        scene,
        [kbm] * GROUP,
        params.seconds,
        active_damping=scene.level_ns_per_m,
        environment=scene.free_of_walls,
        excitation=own.excitation,
        start=(0.0, 0.0),
        keep="records",
        own_torque=True,
    )
    return pooled(spectra_of(found, frequency_hz, own.force_limit_n))


def limits(params: EffectsParams, scene: Scene, method: str) -> Floats:
    """Return limits of K [N/m], B [N s/m] and M [kg] < 0; nan if K = B = M = 0 is not passive."""
    given = Conditions(scene, params.seconds, params.scene.noise)
    plan = plan_limits(LimitsParams(given, (scene.level_ns_per_m,), tolerance=FINE))
    if method == PREDICTED:
        return np.array([scan.predicted for scan in plan.scans])
    return np.array([limit.value for limit in run_limits(plan, TrialStore(None)).limits])


def phase(params: EffectsParams, scene: Scene, method: str) -> Floats:
    """Return the phase [deg] (F,) of Z under the scene's environment."""
    return np.degrees(
        np.angle(impedance(params, scene, params.scene.environment.free, frequencies(), method))
    )


def peak(params: EffectsParams, scene: Scene, method: str) -> Floats:
    """Return height [N s/m] and frequency [Hz] (2,) of the highest maximum of |Z|, with a mass near
    the limit of the whole scene. Without a maximum inside the band the largest |Z|, and nan.
    """
    f = frequencies(PEAK_HZ, count=1000)
    size = np.abs(impedance(params, scene, (0.0, 0.0, peak_mass_kg(params)), f, method))
    rising = np.diff(size) > 0.0
    inner = np.flatnonzero(rising[:-1] & ~rising[1:]) + 1
    if not inner.size:
        return np.array([size.max(), nan])
    highest = inner[np.argmax(size[inner])]
    return np.array([size[highest], f[highest]])


@cache
def peak_mass_kg(params: EffectsParams) -> float:
    """Return the rendered mass for the peak. AnalysisError if no mass owns one."""
    mass_kg = float(limits(params, params.scene, PREDICTED)[2])
    if not mass_kg < 0.0:
        raise AnalysisError(
            f"scene {params.scene.name!r}: not passive even without an environment, so no mass owns"
            " a peak; ask for limits or phase"
        )
    return INSIDE * mass_kg


def compare_each(names: dict[str, float], full: Floats, other: Floats) -> Compared:
    """Compare independent numbers, by `names` with their factors: return the largest relative
    change, and the other numbers.
    """
    change = max(relative(one, two) for one, two in zip(full, other, strict=True))
    return change, dict(zip(names, (other * [*names.values()]).tolist(), strict=True))


def compare_phase(full: Floats, other: Floats) -> Compared:
    """Return the largest phase difference over 90 degrees, that difference, and its frequency."""
    turned = (other - full + 180.0) % 360.0 - 180.0
    worst = int(np.argmax(np.abs(turned)))
    numbers = {"phase deg": float(turned[worst]), "at Hz": float(frequencies()[worst])}
    return abs(numbers["phase deg"]) / 90.0, numbers


QUESTIONS = {
    "limits": Question(limits, partial(compare_each, LIMITS)),
    "phase": Question(phase, compare_phase),
    "peak": Question(peak, partial(compare_each, PEAK)),
}


def relative(full: float, other: float) -> float:
    """Return the change of `other` from `full`: inf if only one of them exists (nan), 0 if neither
    does, or both are equal.
    """
    if full == other:
        return 0.0
    if np.isnan(full) or np.isnan(other):
        return 0.0 if np.isnan(full) and np.isnan(other) else inf
    if full == 0.0:
        raise AnalysisError(
            "a limit of 0 has no relative change; widen the band or strengthen the device"
        )
    return abs(other / full - 1.0)


@dataclass(frozen=True, slots=True)
class EffectsPlan:
    """The effects to leave out, and the method for each."""

    params: EffectsParams
    methods: dict[str, str]  # of an effect's key: PREDICTED or SIMULATED


@dataclass(frozen=True, slots=True)
class LeftOut:
    """The scene without one effect, or without several."""

    effect: str  # "" for the whole scene
    method: str  # PREDICTED or SIMULATED
    numbers: dict[str, float]  # by name with unit
    change: float  # relative, against the whole scene
    cost_s: float  # of the engine, per simulated second
    note: str = ""  # why it cannot be left out


@dataclass(frozen=True, slots=True)
class EffectsResult:
    """The change of the answer without each effect, and the proposal."""

    plan: EffectsPlan
    whole: tuple[LeftOut, LeftOut]  # the whole scene, predicted and simulated
    rows: tuple[LeftOut, ...]  # the most important effect first
    kept: tuple[str, ...]  # effects of the proposal
    proposal: LeftOut  # the scene with those alone, simulated


def plan_effects(params: EffectsParams) -> EffectsPlan:
    """Choose the effects to leave out, and the method for each. ConfigError for an unknown
    question; AnalysisError if the scene does not answer it.
    """
    if params.question not in QUESTIONS:
        raise ConfigError(f"question {params.question!r}: use one of {', '.join(QUESTIONS)}")
    if not params.tolerance > 0.0:
        raise ConfigError(f"tolerance {params.tolerance:g}: must be above 0; 0.02 is 2 %")
    if params.question == "peak":
        peak_mass_kg(params)
    nonlinear = {effect.key for effect in params.scene.effects if effect.nonlinearity}
    return EffectsPlan(
        params,
        {key: SIMULATED if key in nonlinear else PREDICTED for key in params.scene.removable},
    )


def run_effects(plan: EffectsPlan, now_ns: Stopwatch, tell: Progress = silent) -> EffectsResult:
    """Measure. ConfigError as `compose` and `simulate`."""
    study = _Study(plan, Steps(tell, len(plan.methods) + 4), now_ns)
    whole = (study.leave_out((), PREDICTED), study.leave_out((), SIMULATED))
    rows = [study.leave_out((key,), method) for key, method in plan.methods.items()]
    rows.sort(key=lambda row: row.change, reverse=True)
    kept, proposal = study.proposal(rows)
    study.steps.end()
    return EffectsResult(plan, whole, tuple(rows), kept, proposal)


class _Study:
    """One run, which caches the answer and the cost of every set of effects."""

    def __init__(self, plan: EffectsPlan, steps: Steps, now_ns: Stopwatch) -> None:
        self.steps = steps
        self._plan = plan
        params = plan.params
        self._question = QUESTIONS[params.question]
        self._values = cache(
            lambda keys, method: self._question.values(params, params.scene.without(*keys), method)
        )
        self._cost = cache(lambda keys: engine_cost(params.scene.without(*keys), now_ns))

    def leave_out(self, keys: tuple[str, ...], method: str) -> LeftOut:
        """Evaluate the scene without `keys`; the whole scene if there are none."""
        words = ", ".join(keys)
        self.steps.next(f"without {words}" if keys else f"all effects, {method}")
        full = self._values((), method)
        try:
            change, numbers = self._question.compare(full, self._values(keys, method))
        except (ConfigError, AnalysisError) as error:
            return LeftOut(words, method, {}, inf, nan, str(error))
        return LeftOut(words, method, numbers, change, self._cost(keys))

    def proposal(self, rows: list[LeftOut]) -> tuple[tuple[str, ...], LeftOut]:
        """Return the kept effects, and their row; all of them if there is no answer."""
        tolerance = self._plan.params.tolerance
        droppable = [row.effect for row in rows if row.change <= tolerance]
        answered = np.isfinite(self._values((), PREDICTED)).any()
        dropped = self._agreed(reversed(droppable)) if answered else ()
        found = self.leave_out(dropped, SIMULATED)
        while dropped and not found.change <= tolerance:
            dropped = dropped[:-1]
            found = self.leave_out(dropped, SIMULATED)
        kept = tuple(key for key in self._plan.methods if key not in dropped)
        return kept, replace(found, effect=", ".join(kept))

    def _agreed(self, keys: Iterable[str]) -> tuple[str, ...]:
        """Return those of `keys`, least important first, that prediction omits together."""
        full = self._values((), PREDICTED)
        dropped: tuple[str, ...] = ()
        for key in keys:
            with suppress(ConfigError, AnalysisError):
                more = (*dropped, key)
                change, _ = self._question.compare(full, self._values(more, PREDICTED))
                if change <= self._plan.params.tolerance:
                    dropped = more
        return dropped
