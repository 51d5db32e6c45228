"""Simulate a scene with its electrical damping and without: traces, and where noise moves it, the impedance and a verdict.

Both trials get the same perturbation. A scene without damping steps of its own is compared with the level that `damping on`
means. A winding that warms up is looked at by trials of growing length, since a trial tells its temperature at its end.

Params -> plan -> Plan -> run -> Result.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Complexes, Floats
from hapticd.analysis.impedance import Impedance
from hapticd.analysis.passivity import DEFAULT_BAND_HZ
from hapticd.analysis.spa import DEFAULT_LAG
from hapticd.analysis.verdict import Verdict
from hapticd.measure.progress import Progress, Steps, silent
from hapticd.measure.recorded import Recorded
from hapticd.measure.scenes import SUBSTEPS, level, point
from hapticd.measure.sources import Trial as Asked
from hapticd.measure.trial import SHORTEST_WINDOWS, TrialParams, TrialResult, judged, plan_trial
from hapticd.params import ADDED_DAMPING_NS_PER_M
from hapticd.plant.compose import compose
from hapticd.plant.model import Model
from hapticd.plant.scene import Scene
from hapticd.sim.engine import BatchResult, simulate
from hapticd.units import PROBE_RATE_HZ

TEMPERATURES = 12
LEAST_S = SHORTEST_WINDOWS * DEFAULT_LAG / PROBE_RATE_HZ  # for a verdict

DampingSteps = tuple[tuple[float, float], ...]  # time s, level N s/m
ON: DampingSteps = ((0.0, ADDED_DAMPING_NS_PER_M),)


@dataclass(frozen=True, slots=True)
class SceneRunParams:
    """`seconds` None: the scene's own. `band_hz`: of the verdict. `substeps` per 4 kHz sample."""

    scene: Scene
    seconds: float | None = None
    band_hz: tuple[float, float] = DEFAULT_BAND_HZ
    substeps: int = SUBSTEPS


@dataclass(frozen=True, slots=True)
class Leg:
    """One trial to be made: damping steps (time s, level Ns/m); `own`: as the scene file says."""

    name: str
    damping: DampingSteps
    own: bool


@dataclass(frozen=True, slots=True)
class ScenePlan:
    """What will be simulated."""

    params: SceneRunParams
    seconds: float
    legs: tuple[Leg, ...]
    impedance: bool  # noise moves it, long enough for a verdict


@dataclass(frozen=True, eq=False)
class Trial:
    """One trial. `position_m`, `force_n` (ticks,) at the servo rate; `torque_n`, `velocity_m_per_s` (samples,) at 4 kHz.

    `measured`, `predicted` (on its frequencies) and `verdict` are None without noise; `winding_c` is (times s, degC), None
    where the winding's temperature is given.
    """

    leg: Leg
    position_m: Floats
    force_n: Floats
    torque_n: Floats
    velocity_m_per_s: Floats
    velocity_sd_m_per_s: float
    max_force_n: float
    work_j: float
    diverged_at_s: float
    measured: Impedance | None = None
    predicted: Complexes | None = None
    verdict: Verdict | None = None
    winding_c: tuple[Floats, Floats] | None = None


@dataclass(frozen=True, eq=False)
class SceneResult:
    """The scene's own trial is among `trials`; the undamped one comes first."""

    plan: ScenePlan
    trials: tuple[Trial, ...]

    @property
    def scene(self) -> Scene:
        """What was simulated."""
        return self.plan.params.scene


def plan_scene(params: SceneRunParams) -> ScenePlan:
    """Two legs: without damping and with it."""
    scene = params.scene
    own = tuple((step.at_s, step.level_ns_per_m) for step in scene.damping)
    damped = level(scene) > 0.0
    legs = (
        Leg("no added damping", ((0.0, 0.0),), own=not damped),
        Leg(_name(own), own, own=True) if damped else Leg(_name(ON), ON, own=False),
    )
    seconds = params.seconds if params.seconds is not None else scene.seconds
    return ScenePlan(params, seconds, legs, scene.excitation.kind == "noise" and seconds > LEAST_S)


def run_scene(plan: ScenePlan, tell: Progress = silent) -> SceneResult:
    """Simulate. ConfigError as `compose` and `simulate`."""
    model = compose(plan.params.scene)
    steps = Steps(tell, len(plan.legs) * (1 + (TEMPERATURES if model.winding is not None else 0)))
    trials = tuple(_trial(plan, model, leg, steps) for leg in plan.legs)
    steps.end()
    return SceneResult(plan, trials)


def _name(steps: Sequence[tuple[float, float]]) -> str:
    highest = max(height for _, height in steps)
    switched = ", switched" if len({height for _, height in steps}) > 1 else ""
    return f"added damping {highest:.3g} N s/m{switched}"


def _trial(plan: ScenePlan, model: Model, leg: Leg, steps: Steps) -> Trial:
    scene = plan.params.scene
    steps.next(f"simulating, {leg.name}")
    found = _simulated(plan, leg, plan.seconds, "ticks")
    torque, velocity = (np.asarray(channel, np.float64) for channel in found.record(0))
    assert found.position_m is not None
    assert found.force_n is not None
    ticks = int(found.samples[0] * scene.rate_hz / found.rate_hz)
    told = _judged(plan, model, leg, found)
    return Trial(
        leg=leg,
        position_m=found.position_m[0, :ticks].astype(np.float64),
        force_n=found.force_n[0, :ticks].astype(np.float64),
        torque_n=torque,
        velocity_m_per_s=velocity,
        velocity_sd_m_per_s=float(found.sigma_v_m_per_s[0]),
        max_force_n=float(found.max_force_n[0]),
        work_j=float(found.work_j[0]),
        diverged_at_s=float(found.diverged_at_s[0]),
        measured=told.measured if told else None,
        predicted=told.predicted if told else None,
        verdict=told.verdict if told else None,
        winding_c=None if model.winding is None else _temperatures(plan, model, leg, steps),
    )


def _simulated(plan: ScenePlan, leg: Leg, seconds: float, keep: str) -> BatchResult:
    scene, substeps = plan.params.scene, plan.params.substeps
    return simulate(scene, [point(scene)], seconds, damping=leg.damping, substeps=substeps, keep=keep)


def _judged(plan: ScenePlan, model: Model, leg: Leg, found: BatchResult) -> TrialResult | None:
    torque, velocity = (np.asarray(channel, np.float64) for channel in found.record(0))
    if not plan.impedance or torque.size < LEAST_S * PROBE_RATE_HZ:
        return None
    scene = plan.params.scene
    highest = max(height for _, height in leg.damping)
    asked = Asked(point(scene), highest, plan.seconds, scene.excitation)
    most_n = float(found.max_force_n[0])
    recorded = Recorded(torque, velocity, PROBE_RATE_HZ, scene.name, True, "", most_n, model.force_limit_n)
    return judged(plan_trial(TrialParams(asked, scene, plan.params.band_hz)), recorded)


def _temperatures(plan: ScenePlan, model: Model, leg: Leg, steps: Steps) -> tuple[Floats, Floats]:
    assert model.winding is not None
    times, found = np.linspace(0.0, plan.seconds, TEMPERATURES + 1), [model.winding.start_c]
    for seconds in times[1:]:
        steps.next(f"warming up, {leg.name}")
        winding_c = _simulated(plan, leg, float(seconds), "summary").winding_c
        found.append(float("nan") if winding_c is None else float(winding_c[0]))
    return times, np.asarray(found)
