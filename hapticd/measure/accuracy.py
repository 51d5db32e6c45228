"""What accuracy costs in time, measured then and there: error against a reference over seconds, for every way to simulate.

tier          predict, simulate, lock-step
sub-steps     1..32 in a 4 kHz sample: matter to friction, ends and cogging alone
precision     f64, f32
trial length  5..90 s        window   256..8192 samples: only where noise moves the scene
effect        each left out, at 1 sub-step: the difference is what counts, and its kernel compiles soonest

A gauge reads two errors of a setting. `step` is what the setting does to the answer for the same perturbation: the sub-step's,
the precision's, a left-out effect's. `total` is the error of one trial that is made with it, chance or resolution included; of
two settings with the same total the cheaper one is the better. The knee of a sweep is its cheapest setting whose total error is
within 10 % of the best one's: what costs more buys little. A knee at the far end says that the sweep has none.

Noise (`NoiseGauge`): phase of the impedance, rms over the band. The reference of a linear scene is its exact first harmonic
(`analysis.loop`). Of any other it is simulated: a group of trials of the scene's length, each with a perturbation of its own, in
double precision with 32 sub-steps per sample, their spectra added up under a window four times as long as the paper's. It is
known to a third of the deviation of one trial, no better.

A push (`TraceGauge`): position, rms over the trial, in micrometres. The reference is the same trial in double precision with 32
sub-steps per sample. What can be seen of a position is a count, so the total error holds the encoder's rounding (quantum /
sqrt(12)) as well.

The command line passes the processor time of this process (`time.process_time_ns`) to time with: seconds of one core, whatever
else the machine does. What is timed here runs on one thread. The engine computes a group of trials with every instruction, so
its cost is that of a full group, for each trial.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from math import floor, inf, isnan, nan
from pathlib import Path
from typing import TypeVar

import numpy as np

from hapticd.analysis.arrays import Complexes, Floats
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.predict import predict, predicted_impedance
from hapticd.analysis.spa import DEFAULT_LAG, spa
from hapticd.analysis.spectra import Spectra
from hapticd.assembly.lockstep import LockStep
from hapticd.assembly.scene import scene_params
from hapticd.errors import AnalysisError, HapticdError
from hapticd.measure.lockstep_trial import fly
from hapticd.measure.progress import Progress, Steps, silent
from hapticd.measure.scenes import (
    SUBSTEPS,
    calm,
    candidates,
    display,
    filters,
    frequencies,
    is_linear,
    level,
    point,
    pooled,
    spectra_on,
    without,
)
from hapticd.plant.compose import compose
from hapticd.plant.scene import Scene
from hapticd.sim.engine import BatchResult, simulate
from hapticd.sim.engine.shape import LANES
from hapticd.sim.engine.torque import Stream, torque_record
from hapticd.units import NS_PER_S, PROBE_RATE_HZ

REFERENCE = "the reference"
ROUNDS = 3  # of timing
LOCKSTEP_S = 20.0
SWEPT, QUICK_SUBSTEPS = (1, 2, 4, 8, 16, 32), (1, 4, 8)
LENGTHS_S, QUICK_LENGTHS_S = (5.0, 10.0, 20.0, 45.0, 90.0), (5.0, 10.0)
WINDOWS, QUICK_WINDOWS = (256, 512, 1024, 2048, 4096, 8192), (512, 2048)
QUICK_S, QUICK_LOCKSTEP_S = 10.0, 5.0
T = TypeVar("T")
Stopwatch = Callable[[], int]
COST_ENGINE_S = 4.0
REPEATS = 9  # the quickest counts: other programs only make it slower
COST_LOCKSTEP_S = 0.5
SETTLING_TICKS = 100  # of a lock-step stack, before it is timed
GROUP = LANES["f64"]
REFERENCE_LAG = 4 * DEFAULT_LAG
BATCH = 1000
ANALYSED = 8  # records whose analysis is timed
UM_PER_M = 1e6
QUANTUM_M = 0.5e-6  # where the scene has no encoder: that of Weir 2008, section 2
KNEE = 1.1


def timed(now_ns: Stopwatch, call: Callable[[], T]) -> tuple[T, float]:
    """(what `call` returns, seconds that it took)."""
    begin_ns = now_ns()
    found = call()
    return found, (now_ns() - begin_ns) / NS_PER_S


def quickest(now_ns: Stopwatch, call: Callable[[], T], times: int = 3) -> tuple[T, float]:
    """The same for the quickest of `times` calls: what the work takes when nothing disturbs it."""
    found, least_s = timed(now_ns, call)
    for _ in range(times - 1):
        found, seconds = timed(now_ns, call)
        least_s = min(least_s, seconds)
    return found, least_s


@dataclass(frozen=True, slots=True)
class Cost:
    """Seconds of one core per simulated second: `engine_s` of one trial in a full group of `lanes`, `lockstep_s` of the stack."""

    engine_s: float
    lanes: int
    lockstep_s: float


def engine_cost(scene: Scene, now_ns: Stopwatch, seconds: float = COST_ENGINE_S, substeps: int = 1, dtype: str = "f64") -> float:
    """Seconds per simulated second of one trial in a full group. The kernel is compiled before. ConfigError as `simulate`."""
    group = [point(scene)] * LANES[dtype]
    simulate(scene, group, 1.0 / scene.rate_hz, substeps=substeps, dtype=dtype)
    _, spent = quickest(now_ns, lambda: simulate(scene, group, seconds, substeps=substeps, dtype=dtype), REPEATS)
    return spent / (seconds * len(group))


def lockstep_cost(source: str | Path, now_ns: Stopwatch, seconds: float = COST_LOCKSTEP_S) -> float:
    """Seconds per simulated second of the whole stack with the scene's device on the simulated board, nothing enabled."""
    servo, board = scene_params(source)
    ticks = round(seconds * servo.realtime.rate_hz)
    with LockStep(servo, board, keep=False) as stack:
        stack.run(SETTLING_TICKS)
        return quickest(now_ns, lambda: stack.run(ticks))[1] / seconds


def cost(scene: Scene, source: str | Path, now_ns: Stopwatch) -> Cost:
    """Both; `source` is the scene's name or file."""
    return Cost(engine_cost(scene, now_ns), LANES["f64"], lockstep_cost(source, now_ns))


@dataclass(frozen=True, slots=True)
class Setting:
    """How a scene is simulated and looked at; the defaults are those of the procedures. `without`: effects that are left out."""

    seconds: float
    substeps: int = SUBSTEPS
    dtype: str = "f64"
    lag: int = DEFAULT_LAG
    without: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Reading:
    """Errors in the gauge's unit. nan: does not apply."""

    step: float
    total: float


class Gauge(ABC):
    """`exact` is how finely the reference is simulated. After `prepare` it may be read."""

    unit: str
    quantity: str

    def __init__(self, scene: Scene, source: object, seconds: float, exact: Setting, now_ns: Stopwatch) -> None:
        self.scene, self.source, self.seconds, self.exact, self.now_ns = scene, source, seconds, exact, now_ns

    @abstractmethod
    def prepare(self) -> None:
        """Make the reference."""

    @property
    @abstractmethod
    def reference(self) -> str:
        """What errors are measured against, and how well that is known."""

    @abstractmethod
    def read(self, setting: Setting) -> Reading:
        """A trial in a full group. With `without`: against the whole scene as it was read with that setting, else the reference."""

    @abstractmethod
    def cost(self, setting: Setting) -> float:
        """Seconds for one trial of a full group, timed once; the setting has been read before."""

    @abstractmethod
    def alone(self, setting: Setting) -> float:
        """Seconds for a single trial that is asked alone."""

    @abstractmethod
    def lockstep(self, seconds: float) -> tuple[Reading, float]:
        """One trial with the whole product, and what it took. ConfigError or AnalysisError where the scene cannot be flown."""


class NoiseGauge(Gauge):
    """Errors in degrees."""

    unit = "deg"
    quantity = "phase of Z, rms over the band"

    def prepare(self) -> None:
        """Simulate the reference, or compute it."""
        self._whole: dict[Setting, Complexes] = {}
        self._linear, self._limit_n = is_linear(self.scene), display(self.scene).force_limit_n
        flown = self._flown(self.exact, self._torque)
        self._step_free = pooled(self._spectra(flown, DEFAULT_LAG))
        if self._linear:
            self._true, self._known = self._exact(), 0.0
            return
        trials = self._spectra(flown, REFERENCE_LAG)
        half = len(trials) // 2
        self._true, self._known = pooled(trials), 0.5 * phase_rms(pooled(trials[half:]) / pooled(trials[:half]))

    @property
    def reference(self) -> str:
        """Exact or simulated."""
        if self._linear:
            return "exact first harmonic of the linear scene"
        return (
            f"{GROUP} trials of {self.seconds:g} s, {self.exact.substeps} sub-steps, f64, "
            f"window {REFERENCE_LAG}; known to {self._known:.2g} deg"
        )

    def read(self, setting: Setting) -> Reading:
        """A group of trials, their spectra together and one by one."""
        trials = self._spectra(self._flown(setting, self._torque), setting.lag)
        together = pooled(trials)
        if not setting.without:
            self._whole[setting] = together
        like = self._whole[replace(setting, without=())] if setting.without else self._step_free
        comparable = setting.seconds == self.seconds and setting.lag == DEFAULT_LAG
        step = phase_rms(together / like) if comparable else float("nan")
        return Reading(step, self._total(trials))

    def cost(self, setting: Setting) -> float:
        """Of simulation and spectra, these on the window's own grid."""
        found, simulated_s = timed(self.now_ns, lambda: self._flown(setting, self._torque))
        records = [found.record(int(trial)) for trial in np.flatnonzero(~found.diverged)[:ANALYSED]]
        _, analysed_s = timed(self.now_ns, lambda: [spa(*record, lag=setting.lag) for record in records])
        return simulated_s / GROUP + analysed_s / max(1, len(records))

    def alone(self, setting: Setting) -> float:
        """One trial and its spectra."""

        def ask() -> Spectra:
            found = self._flown(setting, self._torque[:1])
            return spectra_on(*found.record(0), self._f, setting.lag)

        return quickest(self.now_ns, ask)[1]

    def lockstep(self, seconds: float) -> tuple[Reading, float]:
        """Noise through the wire."""
        steps = [(step.at_s, step.level_ns_per_m) for step in self.scene.damping]
        torque = self._torque[0, : round(seconds * PROBE_RATE_HZ)]

        def ask() -> Spectra:
            found = fly(str(self.source), torque, steps)
            return spectra_on(found.torque_n, found.velocity_m_per_s, self._f)

        trial, spent = timed(self.now_ns, ask)
        return Reading(float("nan"), self._total([trial])), spent

    def predicted(self) -> tuple[Reading, float, float]:
        """Errors of the predicted Z, its seconds, and those of one of 1,000 environments that are asked for a verdict."""
        model, kbm, damping = compose(self.scene), point(self.scene), level(self.scene)
        z, spent = quickest(
            self.now_ns,
            lambda: predicted_impedance(model, kbm, self._f, damping, filters(self.scene), self._perturbation),
        )
        many = np.tile(kbm, (BATCH, 1))
        _, together = quickest(self.now_ns, lambda: predict(model, many, damping, filters(self.scene), self._perturbation))
        error = phase_rms(z / self._true)
        return Reading(error, error), spent, together / BATCH

    @cached_property
    def _f(self) -> Floats:
        return frequencies()

    @property
    def _perturbation(self) -> Perturbation:
        return Perturbation(self.scene.excitation.psd_n2_per_hz, self.scene.excitation.band_hz)

    def _exact(self) -> Complexes:
        return predicted_impedance(compose(self.scene), point(self.scene), self._f, level(self.scene), filters(self.scene))

    @cached_property
    def _torque(self) -> Floats:
        """(GROUP, samples), the same for every setting."""
        samples, source = round(self.seconds * PROBE_RATE_HZ), self.scene.excitation
        return np.stack([torque_record(source, samples, source.seed, Stream.TORQUE + trial) for trial in range(GROUP)])

    def _flown(self, setting: Setting, torque_n: Floats) -> BatchResult:
        return simulate(
            without(self.scene, *setting.without), np.tile(point(self.scene), (len(torque_n), 1)), setting.seconds,
            excitation=torque_n, own_torque=True, substeps=setting.substeps, dtype=setting.dtype, keep="records",
        )  # fmt: skip

    def _spectra(self, found: BatchResult, lag: int) -> list[Spectra]:
        """Of every trial that has some."""
        return [spectra_on(*found.record(trial), self._f, lag) for trial in calm(found, self._limit_n)]

    def _total(self, trials: list[Spectra]) -> float:
        """Of one trial: rms over trials and frequencies."""
        errors = [phase_rms(trial.cross / trial.velocity / self._true) for trial in trials]
        return float(np.sqrt(np.mean(np.square(errors)))) if errors else float("inf")


def phase_rms(ratio: Complexes) -> float:
    """rms phase [deg] of the ratio of two impedances (F,)."""
    return float(np.degrees(np.sqrt(np.mean(np.angle(ratio) ** 2))))


class TraceGauge(Gauge):
    """Errors in micrometres."""

    unit = "um"
    quantity = "position, rms over the trial"

    def prepare(self) -> None:
        """Simulate the reference."""
        self._whole: dict[Setting, Floats] = {}
        self._model = compose(self.scene)
        self._floor = UM_PER_M * (self._model.encoder_quantum_m or QUANTUM_M) / np.sqrt(12.0)
        self._true = self._position(self._flown(self.exact, 1))

    @property
    def reference(self) -> str:
        """Simulated."""
        return f"the same trial, {self.exact.substeps} sub-steps, f64; position known to a count ({self._floor:.2g} um rms)"

    def read(self, setting: Setting) -> Reading:
        """One trial."""
        position = self._position(self._flown(setting, 1))
        if not setting.without:
            self._whole[setting] = position
        like = self._whole[replace(setting, without=())] if setting.without else self._true
        return self._reading(position - like)

    def cost(self, setting: Setting) -> float:
        """Of a group of equal trials."""
        return timed(self.now_ns, lambda: self._flown(setting, GROUP))[1] / GROUP

    def alone(self, setting: Setting) -> float:
        """One trial."""
        return quickest(self.now_ns, lambda: self._flown(setting, 1))[1]

    def lockstep(self, seconds: float) -> tuple[Reading, float]:
        """The push through the wire, compared with the engine under the forces that the probe then reported.

        AnalysisError for a scene that begins in motion: the stack begins at rest.
        """
        if self.scene.start_velocity_m_per_s or self.scene.start_position_m:
            raise AnalysisError("the scene begins in motion, lock-step at rest")
        samples, rate_hz = round(seconds * PROBE_RATE_HZ), self.scene.rate_hz
        torque = np.resize(torque_record(self.scene.excitation, samples, self.scene.excitation.seed), samples)
        steps = [(step.at_s, step.level_ns_per_m) for step in self.scene.damping]
        flown, spent = timed(self.now_ns, lambda: fly(str(self.source), torque, steps))
        lead, ticks = self._lead(), 1 if self._lead() else 0
        later = [(at_s + (ticks / rate_hz if at_s else 0.0), height) for at_s, height in steps]
        played = np.concatenate((np.zeros(lead), flown.torque_n))[:samples]
        like = simulate(
            self.scene, [point(self.scene)], seconds, damping=later, excitation=played, substeps=self.exact.substeps, keep="ticks"
        )
        position = self._position(like)
        return self._reading(flown.position_m[: len(position) - ticks] - position[ticks:]), spent

    def _lead(self) -> int:
        """Samples by which the engine's ticks, counted from the force, begin before those of the servo."""
        part = self._model.delay_periods % 1.0
        return floor((1.0 - part) * PROBE_RATE_HZ / self.scene.rate_hz) if part else 0

    def _flown(self, setting: Setting, trials: int) -> BatchResult:
        return simulate(
            without(self.scene, *setting.without), np.tile(point(self.scene), (trials, 1)), setting.seconds,
            substeps=setting.substeps, dtype=setting.dtype, keep="ticks",
        )  # fmt: skip

    def _position(self, found: BatchResult) -> Floats:
        assert found.position_m is not None
        return np.asarray(found.position_m[0], np.float64)

    def _reading(self, difference_m: Floats) -> Reading:
        step = UM_PER_M * float(np.sqrt(np.mean(difference_m**2)))
        return Reading(step, float(np.hypot(step, self._floor)))


@dataclass(frozen=True, slots=True)
class Row:
    """One setting: seconds for one trial, its errors (see `gauge`), whether it is the default, and whether the knee."""

    sweep: str
    label: str
    seconds: float
    step: float
    total: float
    default: bool = False
    knee: bool = False
    note: str = ""


def with_knees(rows: list[Row]) -> Iterable[Row]:
    """`rows` with the knee of every sweep marked; effects have none."""
    chosen = {sweep: knee([row for row in rows if row.sweep == sweep]) for sweep in {row.sweep for row in rows} - {"effect"}}
    for row in rows:
        yield replace(row, knee=row is chosen.get(row.sweep))


def knee(rows: Iterable[Row]) -> Row | None:
    """The cheapest of `rows` whose total error is within 10 % of the least; None if none was measured."""
    known = [row for row in rows if not isnan(row.seconds) and row.total < inf]  # nan is not less
    if not known:
        return None
    best = min(row.total for row in known)
    return min((row for row in known if row.total <= KNEE * best), key=lambda row: row.seconds)


@dataclass(frozen=True, slots=True)
class AccuracyParams:
    """`source` is the scene's name or file, for lock-step. `quick`: a coarse look in seconds."""

    scene: Scene
    source: str | Path
    quick: bool = False


@dataclass(frozen=True, slots=True)
class AccuracyPlan:
    """What will be measured."""

    params: AccuracyParams
    noise: bool
    seconds: float
    lockstep_s: float
    exact_substeps: int
    substeps: tuple[int, ...]
    lengths_s: tuple[float, ...]
    windows: tuple[int, ...]
    effects: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class AccuracyResult:
    """All rows, `unit` and `quantity` of the errors, and what they are measured against."""

    plan: AccuracyPlan
    unit: str
    quantity: str
    reference: str
    rows: tuple[Row, ...]

    def sweep(self, name: str) -> tuple[Row, ...]:
        """Rows of one sweep."""
        return tuple(row for row in self.rows if row.sweep == name)

    @property
    def default(self) -> Row:
        """The defaults, in a full group."""
        return next(row for row in self.rows if row.sweep == "sub-steps" and row.default)


def plan_accuracy(params: AccuracyParams) -> AccuracyPlan:
    """The sweeps that the scene calls for."""
    scene, quick = params.scene, params.quick
    noise = scene.excitation.kind == "noise"
    seconds = min(scene.seconds, QUICK_S) if quick else scene.seconds
    substeps = QUICK_SUBSTEPS if quick else SWEPT
    lengths = [length for length in (QUICK_LENGTHS_S if quick else LENGTHS_S) if length < seconds]
    return AccuracyPlan(
        params, noise, seconds,
        lockstep_s=min(seconds, QUICK_LOCKSTEP_S if quick else LOCKSTEP_S),
        exact_substeps=substeps[-1],
        substeps=substeps,
        lengths_s=(*lengths, seconds) if noise else (),
        windows=(QUICK_WINDOWS if quick else WINDOWS) if noise else (),
        effects=candidates(scene),
    )  # fmt: skip


def run_accuracy(plan: AccuracyPlan, now_ns: Stopwatch, tell: Progress = silent) -> AccuracyResult:
    """Measure. ConfigError as `compose` and `simulate`."""
    scene, exact = plan.params.scene, Setting(plan.seconds, plan.exact_substeps)
    wanted = _settings(plan)
    steps = Steps(tell, len(wanted) + ROUNDS + 4)
    gauge: Gauge = (NoiseGauge if plan.noise else TraceGauge)(scene, plan.params.source, plan.seconds, exact, now_ns)
    steps.next("reference")
    gauge.prepare()
    rows = _read(gauge, wanted, steps)
    default = next(row for row in rows if row.default)
    rows = [*_tiers(plan, gauge, steps, default), *rows]
    steps.end()
    return AccuracyResult(plan, gauge.unit, gauge.quantity, gauge.reference, tuple(with_knees(rows)))


def _settings(plan: AccuracyPlan) -> list[tuple[str, str, Setting]]:
    """(sweep, label, setting). An effect is compared with the whole scene at 1 sub-step, which therefore comes before."""
    base = Setting(plan.seconds)
    precisions = [(kind, count) for kind in ("f64", "f32") for count in (1, SUBSTEPS)]
    return [
        *(("sub-steps", str(count), replace(base, substeps=count)) for count in plan.substeps),
        *(("precision", f"{kind}, {count}", replace(base, dtype=kind, substeps=count)) for kind, count in precisions),
        *(("trial length", f"{length:g} s", replace(base, seconds=length)) for length in plan.lengths_s),
        *(("window", str(lag), replace(base, lag=lag)) for lag in plan.windows),
        *(("effect", key, replace(base, substeps=1, without=(key,))) for key in plan.effects),
    ]


def _read(gauge: Gauge, wanted: list[tuple[str, str, Setting]], steps: Steps) -> list[Row]:
    """Errors first; then all are timed in turn, round by round, so that what disturbs the machine meets them alike."""
    known: dict[Setting, Reading] = {}
    notes: dict[Setting, str] = {}
    for sweep, label, setting in wanted:
        steps.next(f"{sweep}: {label}")
        if setting not in known:
            known[setting], notes[setting] = _attempt(lambda setting=setting: gauge.read(setting))  # type: ignore[misc]
    seconds = {setting: nan if notes[setting] else inf for setting in known}
    for _ in range(ROUNDS):
        steps.next("timing")
        seconds = {setting: min(least, gauge.cost(setting)) if least == least else nan for setting, least in seconds.items()}
    return [
        _row(gauge, sweep, label, setting, known[setting], seconds[setting], notes[setting]) for sweep, label, setting in wanted
    ]


def _row(gauge: Gauge, sweep: str, label: str, setting: Setting, found: Reading, seconds: float, note: str) -> Row:
    if setting == gauge.exact:
        return Row(sweep, label, seconds, nan, nan, note=REFERENCE)
    return Row(sweep, label, seconds, found.step, found.total, setting == Setting(gauge.seconds), note=note)


def _tiers(plan: AccuracyPlan, gauge: Gauge, steps: Steps, default: Row) -> Iterable[Row]:
    if isinstance(gauge, NoiseGauge):
        steps.next("predict")
        found, alone, together = gauge.predicted()
        yield Row("tier", "predict, alone", alone, found.step, found.total)
        yield Row("tier", "predict, 1,000 at once", together, found.step, found.total)
    steps.next("simulate")
    alone = gauge.alone(Setting(plan.seconds))
    yield Row("tier", f"simulate {plan.seconds:g} s, alone", alone, default.step, default.total)
    yield Row("tier", f"simulate {plan.seconds:g} s, {GROUP} at once", default.seconds, default.step, default.total, default=True)
    steps.next("lock-step")
    try:
        found, spent = gauge.lockstep(plan.lockstep_s)
        yield Row("tier", f"lock-step {plan.lockstep_s:g} s", spent, found.step, found.total)
    except HapticdError as error:
        yield Row("tier", f"lock-step {plan.lockstep_s:g} s", nan, inf, inf, note=str(error))


def _attempt(ask: Callable[[], Reading]) -> tuple[Reading, str]:
    """A reading, or why there is none."""
    try:
        return ask(), ""
    except HapticdError as error:
        return Reading(inf, inf), str(error)
