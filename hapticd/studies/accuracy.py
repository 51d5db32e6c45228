"""The computing time of accuracy, measured: error against a reference over seconds, for every way
to simulate.

tier          predict, simulate, lock-step
sub-steps     1..32 in a 4 kHz sample: relevant for friction, ends and cogging only
precision     f64, f32
trial length  5..90 s        window   256..8192 samples: only if noise moves the scene
effect        each left out, at 1 sub-step: the difference counts, and its kernel compiles
              soonest

A comparison with the reference gives two errors of a setting. `step` is the change of the answer by
the setting for the same perturbation: by the sub-step, the precision, an omitted effect. `total` is
the error of one trial with that setting, chance or resolution included; of two settings with the
same total the cheaper one is better. `knee` marks the cheapest setting of a sweep whose total error
is within 10 % of the best one's: higher cost gains little, unless it is the last of the sweep.

Noise (`PhaseComparison`): phase of the impedance, rms over the band. The reference of a linear
scene is its exact first harmonic (`model.loop`). For any other scene a group of trials of the
scene's length is simulated, in double precision with 32 sub-steps per sample. Each has a
perturbation of its own, and their spectra are summed under a window four times as long as the
paper's. This reference is known to a third of the deviation of one trial.

A push (`PositionComparison`): position, rms over the trial, in micrometres. The reference is the
same trial in double precision with 32 sub-steps per sample. The resolution of a position is a
count, so the total error includes the encoder's rounding (quantum / sqrt(12)).

Times are measured as in `effects` (`timed`), and spectra of several trials are pooled as there
(`pooled`).

No kernel may be compiled while it is timed (every setting is therefore computed once before).
Limitations: another program that uses the core's caches (the fastest of a few rounds counts).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from math import floor, inf, isnan, nan
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from hapticd.core.arrays import Complexes, Floats
from hapticd.core.errors import AnalysisError, HapticdError
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.model.excitation import Stream, torque_record
from hapticd.model.predict import predict, predicted_impedance
from hapticd.model.scene import Scene
from hapticd.run.lockstep import LockStepTrial, run_lockstep
from hapticd.signal.spectra import DEFAULT_LAG, Spectra, spa
from hapticd.studies.effects import (
    ALONE_REPEATS,
    GROUP,
    Stopwatch,
    pooled,
    spectra_of,
    spectra_on,
    timed,
)
from hapticd.zwidth.engine.batch import BatchResult, simulate
from hapticd.zwidth.sources import SUBSTEPS, display, frequencies
from hapticd.zwidth.store import Progress, Steps, silent

__all__ = ["plan_accuracy", "run_accuracy"]

ROUNDS = 3  # of timing
LOCKSTEP_S = 20.0  # length of the trial in lock-step
SWEPT = (1, 2, 4, 8, 16, 32)  # sub-steps in a sample
QUICK_SUBSTEPS = (1, 4, 8)  # QUICK_...: of a coarse sweep
LENGTHS_S = (5.0, 10.0, 20.0, 45.0, 90.0)
QUICK_LENGTHS_S = (5.0, 10.0)
WINDOWS = (256, 512, 1024, 2048, 4096, 8192)
QUICK_WINDOWS = (512, 2048)
QUICK_S = 10.0  # at most, of a trial
QUICK_LOCKSTEP_S = 5.0
REFERENCE_LAG = 4 * DEFAULT_LAG  # samples
BATCH = 1000  # environments predicted together
ANALYSED = 8  # records whose analysis is timed
UM_PER_M = 1e6
T = TypeVar("T")
QUANTUM_M = 0.5e-6  # if the scene has no encoder: that of Weir 2008, section 2
NEAR_BEST = 1.1  # total errors up to this multiple of the best count as equal


@dataclass(frozen=True, slots=True)
class Setting:
    """The settings of a simulation and its analysis; the defaults are those of the bench."""

    seconds: float
    substeps: int = SUBSTEPS  # in a 4 kHz sample
    dtype: str = "f64"
    lag: int = DEFAULT_LAG  # samples
    without: tuple[str, ...] = ()  # effects that are left out


@dataclass(frozen=True, slots=True)
class AccuracyRow:
    """One setting: its cost and its errors, in the unit of the comparison."""

    sweep: str = ""
    label: str = ""
    seconds: float = inf  # of one core for one trial; inf: not timed, nan: it cannot be run
    step: float = nan  # nan: does not apply
    total: float = inf
    default: bool = False
    knee: bool = False  # the cheapest setting within 10 % of the best
    note: str = ""
    dtype: str = ""  # of the setting


class ReferenceComparison(ABC, Generic[T]):
    """A scene compared with its reference, which is simulated with `exact` on creation.

    T is the answer whose step error is measured; `reference` describes the reference and its
    uncertainty.
    """

    unit: str
    quantity: str
    reference: str
    torque_n: Floats | None = None  # (GROUP, samples), for every setting; None: the scene's own

    def __init__(self, scene: Scene, source: str | Path, exact: Setting, now_ns: Stopwatch) -> None:
        self.scene = scene
        self.source = source
        self.exact = exact
        self.now_ns = now_ns
        self.own = display(scene)
        self._whole: dict[Setting, T] = {}

    @abstractmethod
    def measure(self, setting: Setting) -> AccuracyRow:
        """Measure the errors of a trial. With `without`: against the whole scene at that setting,
        otherwise against the reference.
        """

    def cost(self, setting: Setting, trials: int = GROUP, repeats: int = 1) -> float:
        """Return seconds for one of `trials` together and for its answer; a full group was measured
        before, so its kernel is compiled.
        """
        found, simulated_s = timed(self.now_ns, lambda: self._simulated(setting, trials), repeats)
        return simulated_s / trials + self._analysis_s(found, setting.lag)

    def lockstep(self, seconds: float) -> AccuracyRow:
        """Run one trial with the whole stack; the time is that of its ticks. ConfigError or
        AnalysisError if the scene cannot run there: the stack begins at rest.
        """
        if self.scene.start_velocity_m_per_s or self.scene.start_position_m:
            raise AnalysisError("the scene starts in motion, but lock-step starts at rest")
        samples = round(seconds * PROBE_RATE_HZ)
        source = self.scene.excitation
        if self.torque_n is None:
            torque = np.resize(torque_record(source, samples, source.seed), samples)
        else:
            torque = self.torque_n[0, :samples]
        steps = [(step.at_s, step.level_ns_per_m) for step in self.scene.active_damping]
        trial, spent = timed(self.now_ns, lambda: run_lockstep(str(self.source), torque, steps))
        return replace(self._lockstep_errors(trial), seconds=spent)

    @abstractmethod
    def _lockstep_errors(self, trial: LockStepTrial) -> AccuracyRow:
        """Errors of a trial in lock-step."""

    def _analysis_s(self, found: BatchResult, lag: int) -> float:
        """Seconds for the analysis of one trial."""
        return 0.0

    def _basis(self, setting: Setting, answer: T, reference: T) -> T:
        """Return the value with which `answer` is compared."""
        if setting.without:
            return self._whole[replace(setting, without=())]
        self._whole[setting] = answer
        return reference

    def _simulated(self, setting: Setting, trials: int) -> BatchResult:
        noise = self.torque_n is not None
        return simulate(
            self.scene.without(*setting.without), [self.scene.environment.free] * trials,
            setting.seconds, substeps=setting.substeps, dtype=setting.dtype,
            excitation=None if self.torque_n is None else self.torque_n[:trials], own_torque=noise,
            keep="records" if noise else "ticks",
        )  # fmt: skip


class PhaseComparison(ReferenceComparison[Complexes]):
    """Errors in degrees, of a group of trials."""

    unit = "deg"
    quantity = "phase of Z, rms over the band"

    def __init__(self, scene: Scene, source: str | Path, exact: Setting, now_ns: Stopwatch) -> None:
        super().__init__(scene, source, exact, now_ns)
        samples = round(exact.seconds * PROBE_RATE_HZ)
        noise = scene.excitation
        streams = range(Stream.TORQUE, Stream.TORQUE + GROUP)
        self.torque_n = np.stack(
            [torque_record(noise, samples, noise.seed, stream) for stream in streams]
        )
        self._f = frequencies()
        found = self._simulated(exact, GROUP)
        self._step_free = pooled(self._spectra(found, DEFAULT_LAG))
        if scene.is_linear:
            self._true = predicted_impedance(
                self.own.model,
                scene.environment.free,
                self._f,
                scene.level_ns_per_m,
                self.own.filters,
            )
            self.reference = "exact first harmonic of the linear scene"
            return
        trials = self._spectra(found, REFERENCE_LAG)
        half = len(trials) // 2
        self._true = pooled(trials)
        known_deg = 0.5 * phase_rms(pooled(trials[half:]) / pooled(trials[:half]))
        self.reference = (
            f"{GROUP} trials of {exact.seconds:g} s, {exact.substeps} sub-steps, f64, "
            f"window {REFERENCE_LAG}; known to {known_deg:.2g} deg"
        )

    def measure(self, setting: Setting) -> AccuracyRow:
        """Simulate a group of trials: their spectra together give `step`, one by one `total`."""
        trials = self._spectra(self._simulated(setting, GROUP), setting.lag)
        together = pooled(trials)
        step = phase_rms(together / self._basis(setting, together, self._step_free))
        comparable = (setting.seconds, setting.lag) == (self.exact.seconds, DEFAULT_LAG)
        return AccuracyRow(step=step if comparable else nan, total=self._total(trials))

    def predicted(self) -> Iterable[AccuracyRow]:
        """Yield errors and seconds of the predicted Z, and seconds of one of 1,000 environments
        judged together.
        """
        own = self.own
        kbm = self.scene.environment.free
        asked = (self.scene.level_ns_per_m, own.filters, own.perturbation)
        z, alone_s = timed(
            self.now_ns, lambda: predicted_impedance(own.model, kbm, self._f, *asked), ALONE_REPEATS
        )
        many = np.tile(kbm, (BATCH, 1))
        _, together_s = timed(self.now_ns, lambda: predict(own.model, many, *asked), ALONE_REPEATS)
        error = phase_rms(z / self._true)
        yield AccuracyRow("tier", "predict, alone", alone_s, error, error)
        yield AccuracyRow("tier", "predict, 1,000 at once", together_s / BATCH, error, error)

    def _lockstep_errors(self, trial: LockStepTrial) -> AccuracyRow:
        spectra = spectra_on(trial.torque_n, trial.velocity_m_per_s, self._f)
        return AccuracyRow(total=self._total([spectra]))

    def _analysis_s(self, found: BatchResult, lag: int) -> float:
        """Return the seconds of one analysis, on the window's own grid of frequencies."""
        records = [found.record(int(trial)) for trial in np.flatnonzero(~found.diverged)[:ANALYSED]]
        _, spent = timed(self.now_ns, lambda: [spa(*record, lag=lag) for record in records])
        return spent / max(1, len(records))

    def _spectra(self, found: BatchResult, lag: int) -> list[Spectra]:
        return spectra_of(found, self._f, self.own.force_limit_n, lag)

    def _total(self, trials: list[Spectra]) -> float:
        """Return the error of one trial: rms over trials and frequencies."""
        errors = [phase_rms(trial.cross / trial.velocity / self._true) for trial in trials]
        return float(np.sqrt(np.mean(np.square(errors))))


def phase_rms(ratio: Complexes) -> float:
    """Return the rms phase [deg] of the ratio of two impedances (F,)."""
    return float(np.degrees(np.sqrt(np.mean(np.angle(ratio) ** 2))))


class PositionComparison(ReferenceComparison[Floats]):
    """Errors in micrometres, of one trial: all are equal."""

    unit = "um"
    quantity = "position, rms over the trial"

    def __init__(self, scene: Scene, source: str | Path, exact: Setting, now_ns: Stopwatch) -> None:
        super().__init__(scene, source, exact, now_ns)
        self._floor = UM_PER_M * (self.own.model.encoder_quantum_m or QUANTUM_M) / np.sqrt(12.0)
        self._true, _ = self._simulated(exact, 1).traces(0)
        known = f"position known to a count ({self._floor:.2g} um rms)"
        self.reference = f"the same trial, {exact.substeps} sub-steps, f64; {known}"

    def measure(self, setting: Setting) -> AccuracyRow:
        """Simulate one trial, and compare its positions."""
        position, _ = self._simulated(setting, 1).traces(0)
        return self._row(position - self._basis(setting, position, self._true))

    def _lockstep_errors(self, trial: LockStepTrial) -> AccuracyRow:
        """Return the errors of the push through the wire, compared with the engine under the forces
        that the probe reported. The engine's ticks, counted from the force, may begin a fraction of
        a period before those of the servo: `lead` samples.
        """
        rate_hz = self.scene.rate_hz
        part = self.own.model.delay_periods % 1.0
        lead = floor((1.0 - part) * PROBE_RATE_HZ / rate_hz) if part else 0
        ticks = 1 if lead else 0
        later = [
            (step.at_s + (ticks / rate_hz if step.at_s else 0.0), step.level_ns_per_m)
            for step in self.scene.active_damping
        ]
        samples = trial.torque_n.size
        like = simulate(
            self.scene, [self.scene.environment.free], samples / PROBE_RATE_HZ,
            active_damping=later, substeps=self.exact.substeps, keep="ticks",
            excitation=np.concatenate((np.zeros(lead), trial.torque_n))[:samples],
        )  # fmt: skip
        position, _ = like.traces(0)
        return self._row(trial.position_m[: len(position) - ticks] - position[ticks:])

    def _row(self, difference_m: Floats) -> AccuracyRow:
        step = UM_PER_M * float(np.sqrt(np.mean(difference_m**2)))
        return AccuracyRow(step=step, total=float(np.hypot(step, self._floor)))


Comparison = PhaseComparison | PositionComparison


def mark_knees(rows: list[AccuracyRow]) -> Iterable[AccuracyRow]:
    """Yield `rows` with the cheapest setting within 10 % of the best marked in every sweep but that
    of effects.
    """
    chosen = {
        sweep: cheapest_near_best([row for row in rows if row.sweep == sweep])
        for sweep in {row.sweep for row in rows} - {"effect"}
    }
    for row in rows:
        yield replace(row, knee=row is chosen.get(row.sweep))


def cheapest_near_best(rows: Iterable[AccuracyRow]) -> AccuracyRow | None:
    """Return the cheapest of `rows` whose total error is within 10 % of the minimum; None if none
    was measured.
    """
    known = [row for row in rows if not isnan(row.seconds) and row.total < inf]  # nan is not less
    if not known:
        return None
    best = min(row.total for row in known)
    return min((row for row in known if row.total <= NEAR_BEST * best), key=lambda row: row.seconds)


@dataclass(frozen=True, slots=True)
class AccuracyPlan:
    """The planned measurements."""

    scene: Scene
    source: str | Path  # the scene's name or file, for the trial in lock-step
    noise: bool  # moves the scene
    lockstep_s: float
    exact: Setting  # of the reference
    wanted: tuple[tuple[str, str, Setting], ...]  # (sweep, label, setting) in turn


@dataclass(frozen=True, slots=True)
class AccuracyResult:
    """All rows, and the meaning of their errors."""

    plan: AccuracyPlan
    unit: str  # of the errors
    quantity: str
    reference: str  # reference of the errors
    rows: tuple[AccuracyRow, ...]

    def sweep(self, name: str) -> tuple[AccuracyRow, ...]:
        """Rows of one sweep."""
        return tuple(row for row in self.rows if row.sweep == name)

    @property
    def default(self) -> AccuracyRow:
        """The row of the defaults, in a full group."""
        return next(row for row in self.sweep("sub-steps") if row.default)


def plan_accuracy(scene: Scene, source: str | Path, quick: bool = False) -> AccuracyPlan:
    """Return the sweeps for the scene; `quick`: a coarse set, in seconds. An effect is compared
    with the whole scene at 1 sub-step, which therefore comes before.
    """
    noise = scene.excitation.kind == "noise"
    base = Setting(min(scene.seconds, QUICK_S) if quick else scene.seconds)
    substeps = QUICK_SUBSTEPS if quick else SWEPT
    shorter = [one for one in (QUICK_LENGTHS_S if quick else LENGTHS_S) if one < base.seconds]
    lengths_s = (*shorter, base.seconds) if noise else ()
    windows = (QUICK_WINDOWS if quick else WINDOWS) if noise else ()
    kinds = [(dtype, count) for dtype in ("f64", "f32") for count in (1, SUBSTEPS)]
    wanted = (
        *(("sub-steps", str(count), replace(base, substeps=count)) for count in substeps),
        *(
            ("precision", f"{dtype}, {count}", replace(base, dtype=dtype, substeps=count))
            for dtype, count in kinds
        ),
        *(("trial length", f"{length:g} s", replace(base, seconds=length)) for length in lengths_s),
        *(("window", str(lag), replace(base, lag=lag)) for lag in windows),
        *(("effect", key, replace(base, substeps=1, without=(key,))) for key in scene.removable),
    )
    lockstep_s = min(base.seconds, QUICK_LOCKSTEP_S if quick else LOCKSTEP_S)
    return AccuracyPlan(
        scene, source, noise, lockstep_s, replace(base, substeps=substeps[-1]), wanted
    )


def run_accuracy(plan: AccuracyPlan, now_ns: Stopwatch, tell: Progress = silent) -> AccuracyResult:
    """Measure. ConfigError as `compose` and `simulate`."""
    steps = Steps(tell, len(plan.wanted) + ROUNDS + 4)
    steps.next("reference")
    kind: type[Comparison] = PhaseComparison if plan.noise else PositionComparison
    comparison = kind(plan.scene, plan.source, plan.exact, now_ns)
    swept = _swept(plan, comparison, steps)
    rows = [*_tiers(plan, comparison, steps, next(row for row in swept if row.default)), *swept]
    steps.end()
    return AccuracyResult(
        plan, comparison.unit, comparison.quantity, comparison.reference, tuple(mark_knees(rows))
    )


def _swept(plan: AccuracyPlan, comparison: Comparison, steps: Steps) -> list[AccuracyRow]:
    """Measure the errors first, then time all settings in turn, round by round, so that
    disturbances affect them alike.
    """
    rows: dict[Setting, AccuracyRow] = {}
    for sweep, label, setting in plan.wanted:
        steps.next(f"{sweep}: {label}")
        rows[setting] = rows.get(setting) or _row(partial(comparison.measure, setting))
    default = Setting(plan.exact.seconds)
    rows[default] = replace(rows[default], default=True)
    rows[plan.exact] = replace(rows[plan.exact], step=nan, total=nan, note="the reference")
    for _ in range(ROUNDS):
        steps.next("timing")
        for setting, row in rows.items():
            if not isnan(row.seconds):
                rows[setting] = replace(row, seconds=min(row.seconds, comparison.cost(setting)))
    return [
        replace(rows[each], sweep=sweep, label=label, dtype=each.dtype)
        for sweep, label, each in plan.wanted
    ]


def _row(read: Callable[[], AccuracyRow]) -> AccuracyRow:
    """Return the measured row, or the reason why it cannot be measured."""
    try:
        return read()
    except HapticdError as error:
        return AccuracyRow(seconds=nan, step=inf, note=str(error))


def _tiers(
    plan: AccuracyPlan,
    comparison: Comparison,
    steps: Steps,
    default: AccuracyRow,
) -> Iterable[AccuracyRow]:
    if isinstance(comparison, PhaseComparison):
        steps.next("predict")
        yield from comparison.predicted()
    steps.next("simulate")
    seconds = plan.exact.seconds
    words = f"simulate {seconds:g} s"
    alone_s = comparison.cost(Setting(seconds), 1, ALONE_REPEATS)
    yield replace(default, sweep="tier", label=f"{words}, alone", seconds=alone_s, default=False)
    yield replace(default, sweep="tier", label=f"{words}, {GROUP} at once")
    steps.next("lock-step")
    yield replace(
        _row(partial(comparison.lockstep, plan.lockstep_s)),
        sweep="tier",
        label=f"lock-step {plan.lockstep_s:g} s",
    )
