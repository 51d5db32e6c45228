"""A single scene: run it with active damping and without, find the largest stable active damping,
and compare explicit integrators on its device.

Both trials of a run get the same perturbation. A scene without damping steps of its own is compared
with the level of `damping on`. The temperature of a winding that warms up comes from trials of
growing length, because a trial reports it only at its end.

The largest active damping of the device is found by bisection on the eigenvalues of the open device
in continuous time (`model.discrete`). The largest with the scene's environment uses those of the
exact map of one servo tick (`model.loop`), without Coulomb friction. Above the first the analog
circuit oscillates whatever the servo does. The second is a range, because too little damping can be
unstable as well. The resistance compensation limits the device (Weir, Colgate and Peshkin 2008,
section 5): a winding colder than assumed leaves a ceiling of K^2 / dR, a hot one may leave none.
The ceiling is therefore computed for a range of winding temperatures.

Explicit Euler and Runge-Kutta 4 are compared with the exact map, on the linear device of the scene:

    exact   x(t + h) = e^(A h) x(t)                     any h
    euler   R(z) = 1 + z                                |R(h lambda)| <= 1 for every eigenvalue
                                                        lambda of A
    rk4     R(z) = 1 + z + z^2/2 + z^3/6 + z^4/24       the same; about h < 2.79 / |lambda| for a
                                                        real one

Electronics of microseconds determine the step, whether or not they matter: 5 kHz of amplifier
bandwidth require a step below 88 us for RK4, although the answer is on a scale of milliseconds. The
device is released with all bodies at one speed, for 20 ms. The error is that of the state, each
coordinate over its largest value.

Limitations: a range of stable levels with a gap in it, narrower than the scan that begins the
bisection (`SCAN` levels).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, nan, tau
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.linalg import matrix_power

from hapticd.core.arrays import Complexes, Floats
from hapticd.core.errors import ConfigError
from hapticd.core.params import ACTIVE_DAMPING_NS_PER_M
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.model.compose import compose, compose_device
from hapticd.model.discrete import edge, expm, modes, stability
from hapticd.model.effects import WindingTemperature
from hapticd.model.loop import spectral_radius
from hapticd.model.model import Model
from hapticd.model.scene import Scene
from hapticd.render.winding import LEAST_LOOP_GAIN
from hapticd.signal.spectra import DEFAULT_LAG
from hapticd.zwidth.engine.batch import BatchResult, simulate
from hapticd.zwidth.simulated import simulated
from hapticd.zwidth.sources import SUBSTEPS, Trial
from hapticd.zwidth.store import Progress, Steps, silent
from hapticd.zwidth.trial import SHORTEST_WINDOWS, TrialParams, TrialResult, judged, plan_trial

__all__ = ["SceneTrial", "ceiling", "compare_integrators", "plan_scene", "run_scene"]

TEMPERATURES = 12  # of a winding that warms up, at equal distances of time
LEAST_S = SHORTEST_WINDOWS * DEFAULT_LAG / PROBE_RATE_HZ  # for a verdict
HIGHEST_NS_PER_M = 1e6  # a device that is stable up to here has no ceiling
SCAN = 400  # levels of the loop before bisection
WARMER_K = (-40.0, -20.0, -10.0, -5.0, 0.0, 10.0, 40.0)
STEPS_PER_MS = tuple(2**k for k in range(12))
SPAN_MS = 20  # at the end of each millisecond the error is taken
SPEED_M_PER_S = 0.1
BLOWN_UP = 1.0  # error beyond which the answer is lost
ORDERS = {"exact": 0, "rk4": 4, "euler": 1}  # of the power series; the exact map is not a series
LONGEST_S = 1.0  # steps up to here are tried
DRIFT = 1e-6  # of the fastest pole: a slower one only drifts

DampingSteps = tuple[tuple[float, float], ...]  # time s, level N s/m
ON: DampingSteps = ((0.0, ACTIVE_DAMPING_NS_PER_M),)


@dataclass(frozen=True, slots=True)
class DampingCase:
    """The active damping of one trial of the scene."""

    name: str
    active_damping: DampingSteps
    own: bool  # from the scene file


@dataclass(frozen=True, slots=True)
class ScenePlan:
    """The planned simulation."""

    scene: Scene
    seconds: float
    cases: tuple[DampingCase, ...]
    impedance: bool  # noise moves it, long enough for a verdict


@dataclass(frozen=True, eq=False)
class SceneTrial:
    """One trial of the scene."""

    case: DampingCase
    found: BatchResult  # with its ticks
    judged: TrialResult | None = None  # None without noise, or if it ended too early
    winding_c: tuple[Floats, Floats] | None = None  # (times [s], degC); None: a given temperature

    @property
    def numbers(self) -> dict[str, float]:
        """Rms velocity, largest command, the probe's work and the time of divergence, by name."""
        found = self.found
        return {
            "velocity_sd_m_per_s": float(found.sigma_v_m_per_s[0]),
            "max_force_n": float(found.max_force_n[0]),
            "work_j": float(found.work_j[0]),
            "diverged_at_s": float(found.diverged_at_s[0]),
        }


@dataclass(frozen=True, eq=False)
class SceneResult:
    """The simulated trials."""

    plan: ScenePlan
    trials: tuple[SceneTrial, ...]  # the undamped one first; the scene's own is among them


def plan_scene(scene: Scene, seconds: float | None = None) -> ScenePlan:
    """Plan two cases: without active damping and with it. `seconds` None: the scene's own."""
    own = tuple((step.at_s, step.level_ns_per_m) for step in scene.active_damping)
    damped = scene.level_ns_per_m > 0.0
    cases = (
        DampingCase("no active damping", ((0.0, 0.0),), own=not damped),
        DampingCase(_name(own), own, own=True) if damped else DampingCase(_name(ON), ON, own=False),
    )
    seconds = scene.seconds if seconds is None else seconds
    return ScenePlan(scene, seconds, cases, scene.excitation.kind == "noise" and seconds > LEAST_S)


def run_scene(plan: ScenePlan, tell: Progress = silent) -> SceneResult:
    """Simulate. ConfigError as `compose` and `simulate`."""
    winding = compose(plan.scene).winding
    steps = Steps(tell, len(plan.cases) * (1 + (TEMPERATURES if winding else 0)))
    trials = tuple(
        _trial(plan, case, winding.heating.start_c if winding else None, steps)
        for case in plan.cases
    )
    steps.end()
    return SceneResult(plan, trials)


def _name(steps: Sequence[tuple[float, float]]) -> str:
    highest = max(height for _, height in steps)
    switched = ", switched" if len({height for _, height in steps}) > 1 else ""
    return f"active damping {highest:.3g} N s/m{switched}"


def _trial(plan: ScenePlan, case: DampingCase, start_c: float | None, steps: Steps) -> SceneTrial:
    steps.next(f"simulating, {case.name}")
    found = _simulated(plan, case, plan.seconds, "ticks")
    heated = None if start_c is None else _temperatures(plan, start_c, case, steps)
    return SceneTrial(case, found, _judged(plan, case, found) if plan.impedance else None, heated)


def _simulated(plan: ScenePlan, case: DampingCase, seconds: float, keep: str) -> BatchResult:
    return simulate(
        plan.scene,
        [plan.scene.environment.free],
        seconds,
        active_damping=case.active_damping,
        substeps=SUBSTEPS,
        keep=keep,
    )


def _judged(plan: ScenePlan, case: DampingCase, found: BatchResult) -> TrialResult | None:
    recorded = simulated(plan.scene, found)
    scene = plan.scene
    if recorded.seconds < LEAST_S:
        return None
    trial = Trial(
        scene.environment.free,
        max(height for _, height in case.active_damping),
        plan.seconds,
        scene.excitation,
    )
    return judged(plan_trial(TrialParams(trial, scene)), recorded)


def _temperatures(
    plan: ScenePlan, start_c: float, case: DampingCase, steps: Steps
) -> tuple[Floats, Floats]:
    times = np.linspace(0.0, plan.seconds, TEMPERATURES + 1)
    found = [start_c]
    for seconds in times[1:]:
        steps.next(f"warming up, {case.name}")
        winding_c = _simulated(plan, case, float(seconds), "summary").winding_c
        found.append(nan if winding_c is None else float(winding_c[0]))
    return times, np.asarray(found)


@dataclass(frozen=True, slots=True)
class Ceiling:
    """The largest stable active damping. The device alone is stable up to `device`; with the
    scene's environment the loop is stable from `lowest` to `highest`.
    """

    device: float  # N s/m; inf: always stable
    oscillation_hz: float  # of the device just above; nan if it grows without oscillation
    lowest: float  # N s/m; nan: never stable
    highest: float  # N s/m
    scene: float  # N s/m, the scene's own level
    loop_gain: float  # g dR / K^2 at that level
    bounded: float  # N s/m that keeps the loop gain above LEAST_LOOP_GAIN, at most `device`
    # (winding minus assumed temperature [K], `device` and `bounded` then); empty without a winding
    warmer: tuple[tuple[float, float, float], ...]


def ceiling(scene: Scene) -> Ceiling:
    """Return the ceiling of a scene, whether or not its own level is stable. ConfigError as
    `compose_device`, or for a shorted motor.
    """
    model = compose_device(scene.name, scene.effects, scene.rate_hz)
    if not (model.a1.any() or model.b1.any()):
        raise ConfigError(
            f"scene {scene.name!r}: the motor is shorted and obeys no damping command; leave out"
            " 'crowbar'"
        )
    top = damping_ceiling(model, HIGHEST_NS_PER_M)
    asked = scene.level_ns_per_m
    growing = max(modes(model, top), key=lambda mode: mode.real)
    windings = [effect for effect in scene.effects if isinstance(effect, WindingTemperature)]
    lowest, highest = _loop(scene, model, top)
    return Ceiling(
        device=_finite(top),
        oscillation_hz=nan if top >= HIGHEST_NS_PER_M else float(abs(growing.imag) / tau),
        lowest=lowest,
        highest=_finite(highest),
        scene=asked,
        loop_gain=stability(model, asked).loop_gain,
        bounded=_finite(_bounded(model, top)),
        warmer=tuple((more, *_warmer(scene, own, more)) for own in windings for more in WARMER_K),
    )


def _finite(level_ns_per_m: float) -> float:
    return float(level_ns_per_m) if level_ns_per_m < HIGHEST_NS_PER_M else inf


def _bounded(model: Model, top_ns_per_m: float) -> float:
    """Return the level at which an over-compensated winding reaches LEAST_LOOP_GAIN, up to
    `top`.
    """
    per_level = model.level_gain * model.residual_ohm / model.torque_constant_n_per_a**2
    return min(top_ns_per_m, LEAST_LOOP_GAIN / per_level) if per_level < 0.0 else top_ns_per_m


def _warmer(scene: Scene, own: WindingTemperature, kelvin: float) -> tuple[float, float]:
    """Return the ceiling and its bound with the winding `kelvin` above its compensation."""
    other = replace(own, temperature_c=own.compensated_c + kelvin)
    effects = tuple(other if effect is own else effect for effect in scene.effects)
    model = compose_device(scene.name, effects, scene.rate_hz)
    top = damping_ceiling(model, HIGHEST_NS_PER_M)
    return _finite(top), _finite(_bounded(model, top))


def _loop(scene: Scene, model: Model, top: float) -> tuple[float, float]:
    """Return (lowest, highest) level at which the sampled loop is stable; nan if it never is."""

    def stable(level_ns_per_m: float) -> bool:
        return bool(
            spectral_radius(
                model, np.array([scene.environment.free]), level_ns_per_m, scene.environment.filters
            )[0]
            < 1.0
        )

    levels = [0.0, *np.geomspace(1e-3, top, SCAN).tolist()]
    good = [stable(each) for each in levels]
    if not any(good):
        return nan, nan
    first = good.index(True)
    last = [*good, False].index(False, first) - 1
    # at either end of the scan the edge is that end itself
    below = levels[max(first - 1, 0)]
    above = levels[min(last + 1, SCAN)]
    return edge(stable, levels[first], below), edge(stable, levels[last], above)


@dataclass(frozen=True, eq=False)
class Integrators:
    """Explicit methods and the exact map, by name."""

    steps_per_ms: Floats  # (S,)
    error: dict[str, Floats]  # of a method (S,), relative; inf where it blew up
    longest_s: dict[str, float]  # its largest stable step
    fastest_s: float  # shortest time constant of the device


def compare_integrators(scene: Scene) -> Integrators:
    """Compare the methods on the scene's device at its highest active damping. ConfigError as
    `compose`.
    """
    model = compose(scene)
    a = model.a(scene.level_ns_per_m)
    start = np.array(
        [SPEED_M_PER_S if state.name.endswith("_velocity") else 0.0 for state in model.states]
    )
    true = _marks(expm(a * 1e-3), start)
    with np.errstate(over="ignore", invalid="ignore"):
        error = {
            method: np.array(
                [
                    _error(matrix_power(_step(method, a * (1e-3 / count)), count), start, true)
                    for count in STEPS_PER_MS
                ]
            )
            for method in ORDERS
        }
    poles = np.asarray(np.linalg.eigvals(a), np.complex128)
    longest = {method: _longest(method, poles) for method in ORDERS}
    fastest = float(np.abs(poles).max())
    fastest_s = 1.0 / fastest if fastest else inf
    return Integrators(np.array(STEPS_PER_MS, np.float64), error, longest, fastest_s)


def _error(millisecond: Floats, start: Floats, true: Floats) -> float:
    """Return the largest error of any coordinate, over its largest value."""
    size = np.abs(true).max(axis=0)
    error = float(
        (np.abs(_marks(millisecond, start) - true) / np.where(size == 0.0, 1.0, size)).max()
    )
    return error if error < BLOWN_UP else inf


def _step(method: str, ah: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the matrix of one step of a method; `ah` is A h."""
    if method == "exact":
        return expm(ah)
    matrix = term = np.eye(len(ah))
    for k in range(1, ORDERS[method] + 1):
        term = term @ ah / k
        matrix = matrix + term
    return matrix


def _marks(millisecond: Floats, start: Floats) -> Floats:
    """Return (SPAN_MS, n): the state at the end of each millisecond; `millisecond` is the matrix of
    one.
    """
    return np.array([matrix_power(millisecond, count) @ start for count in range(1, SPAN_MS + 1)])


def _longest(method: str, poles: Complexes) -> float:
    """Return the largest step at which no mode grows; inf for a device that only drifts."""
    if method == "exact" or not poles.any():
        return inf
    moving = np.abs(poles) > DRIFT * np.abs(poles).max()  # drift neither grows nor decays
    own = np.diag(poles[moving])
    return edge(lambda h: bool(np.abs(_step(method, own * h)).max() <= 1.0), 0.0, LONGEST_S)


def damping_ceiling(model: Model, highest_ns_per_m: float = 1e6) -> float:
    """Return the largest stable damping level [Ns/m] of the device, at most `highest_ns_per_m`."""
    if stability(model, highest_ns_per_m).stable:
        return highest_ns_per_m
    return edge(lambda level: stability(model, level).stable, 0.0, highest_ns_per_m)
