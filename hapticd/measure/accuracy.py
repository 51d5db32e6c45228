"""What accuracy costs in time, measured then and there: error against a reference over seconds, for every way to simulate.

tier          predict, simulate, lock-step
sub-steps     1..32 in a 4 kHz sample: matter to friction, ends and cogging alone
precision     f64, f32
trial length  5..90 s        window   256..8192 samples: only where noise moves the scene
effect        each left out, at 1 sub-step: the difference is what counts, and its kernel compiles soonest
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from math import inf, nan
from pathlib import Path

from hapticd.errors import HapticdError
from hapticd.measure.gauge import GROUP, Gauge, Reading, Setting
from hapticd.measure.gauge_noise import NoiseGauge
from hapticd.measure.gauge_trace import TraceGauge
from hapticd.measure.knee import Row, with_knees
from hapticd.measure.progress import Progress, Steps, silent
from hapticd.measure.scenes import SUBSTEPS as DEFAULT_SUBSTEPS
from hapticd.measure.scenes import candidates
from hapticd.measure.stopwatch import Stopwatch
from hapticd.plant.scene import Scene

REFERENCE = "the reference"
ROUNDS = 3  # of timing
LOCKSTEP_S = 20.0
SUBSTEPS, QUICK_SUBSTEPS = (1, 2, 4, 8, 16, 32), (1, 4, 8)
LENGTHS_S, QUICK_LENGTHS_S = (5.0, 10.0, 20.0, 45.0, 90.0), (5.0, 10.0)
WINDOWS, QUICK_WINDOWS = (256, 512, 1024, 2048, 4096, 8192), (512, 2048)
QUICK_S, QUICK_LOCKSTEP_S = 10.0, 5.0


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
    substeps = QUICK_SUBSTEPS if quick else SUBSTEPS
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
    precisions = [(kind, count) for kind in ("f64", "f32") for count in (1, DEFAULT_SUBSTEPS)]
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
