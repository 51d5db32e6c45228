"""Other tools on the engine's scene: MuJoCo stepped under a 1 kHz controller, scipy's solver, and
numba for one trial.

Each plays `ticks` ticks of trial 0 of `engine_scene` and returns its rms velocity, which verifies
that the scene is the same.
"""

from collections.abc import Callable
from dataclasses import replace
from math import floor, tanh

import numpy as np

from benchmarks import engine_scene as scene
from benchmarks.worker import BenchError
from hapticd.core.environment import FilterParams
from hapticd.render.law import at_rest, design_coefficients, render
from hapticd.zwidth.engine.kernels import kernel
from hapticd.zwidth.engine.source import LAW_STATE

STEP_S = 0.00025
SAMPLES = 4
WORLD = f"""
<mujoco><option timestep="{STEP_S}" gravity="0 0 0" integrator="implicitfast"/>
<worldbody><body name="rotor">
  <joint name="x" type="slide" axis="1 0 0" damping="{scene.VISCOUS_NS_PER_M}"
    frictionloss="{scene.COULOMB_N}" solreffriction="{2 * STEP_S} 1"/>
  <geom type="sphere" size="0.01" mass="{scene.ROTOR_KG}" contype="0" conaffinity="0"/>
  <body name="slider">
    <joint name="gap" type="slide" axis="1 0 0" stiffness="{scene.STIFFNESS_N_PER_M}"
     damping="{scene.DAMPING_NS_PER_M}"/>
    <geom type="sphere" size="0.01" mass="{scene.SLIDER_KG}" contype="0" conaffinity="0"/>
  </body></body></worldbody></mujoco>
"""
TOLERANCE = 1e-10  # of positions [m], which are read in counts of 5e-7
SMOOTH_M_PER_S = (
    1e-4  # width of the tanh that replaces friction for a solver that needs a derivative
)

Torque = "np.ndarray[tuple[int], np.dtype[np.float64]]"


class Controller:
    """The servo's law at 1 kHz on counts, for trial 0."""

    def __init__(self) -> None:
        self._environment = (
            *scene.environments(1)[0],
            0.0,
            scene.LIMIT_N,
            0.0,
            0.0,
            0.0,
            0.0,
            -np.inf,
            np.inf,
            0.0,
        )
        self._coefficients = design_coefficients(FilterParams(100.0), FilterParams(72.0), 1000.0)
        self._state = at_rest(0.0)

    def force(self, position_m: float) -> float:
        """Return the force for a sample."""
        counted = floor(position_m / scene.QUANTUM_M + 0.5) * scene.QUANTUM_M
        force, *_, self._state = render(counted, self._state, self._environment, self._coefficients)
        return force


def mujoco_run(torque: Torque, ticks: int) -> Callable[[], float]:
    """Prepare a run in MuJoCo. BenchError without it."""
    try:
        import mujoco
    except ImportError as error:
        raise BenchError(f"{error}: `make bench` installs it") from error
    world = mujoco.MjModel.from_xml_string(WORLD)
    steps = torque.tolist()

    def run() -> float:
        data = mujoco.MjData(world)
        controller = Controller()
        squared = 0.0
        applied = data.qfrc_applied
        position = data.qpos
        for tick in range(ticks):
            force = controller.force(position[0] + position[1])
            for j in range(SAMPLES):
                before = position[0]
                applied[0] = force + steps[tick * SAMPLES + j]
                mujoco.mj_step(world, data)
                squared += ((position[0] - before) / STEP_S) ** 2
        return float((squared / (ticks * SAMPLES)) ** 0.5)

    return run


def solve_ivp_run(torque: Torque, ticks: int) -> Callable[[], float]:
    """Prepare a run in scipy. BenchError without it. Friction is smoothed for the step control of
    the solver.
    """
    try:
        from scipy.integrate import solve_ivp
    except ImportError as error:
        raise BenchError(f"{error}: `make bench` installs it") from error

    def rates(_: float, state: Torque, force: float) -> list[float]:
        x, v, y, u = state
        spring = scene.STIFFNESS_N_PER_M * (x - y) + scene.DAMPING_NS_PER_M * (v - u)
        drag = scene.VISCOUS_NS_PER_M * v + scene.COULOMB_N * tanh(v / SMOOTH_M_PER_S)
        return [v, (force - spring - drag) / scene.ROTOR_KG, u, spring / scene.SLIDER_KG]

    def run() -> float:
        state = np.zeros(4)
        controller = Controller()
        squared = 0.0
        for tick in range(ticks):
            force = controller.force(state[2])
            for j in range(SAMPLES):
                before = state[0]
                pushed = force + torque[tick * SAMPLES + j]
                state = solve_ivp(
                    rates, (0.0, STEP_S), state, args=(pushed,), rtol=1e-6, atol=TOLERANCE
                ).y[:, -1]
                squared += ((state[0] - before) / STEP_S) ** 2
        return float((squared / (ticks * SAMPLES)) ** 0.5)

    return run


class ScalarNumba:
    """The same kernel source for one trial at a time: numba without lanes."""

    def __init__(self, ours: scene.Lanes) -> None:
        made = ours.group.made
        rows = ours.group.rows
        self._module = kernel(replace(made.shape, lanes=1))
        self._state = np.array([rows[name][0] for name in self._module.ROWS], made.scalar)
        self._coefficients = ours.group.coefficients
        self._torque = ours.torque
        self._ticks = ours.ticks
        for name in (*LAW_STATE, "U", *(name for name in self._module.ROWS if name[0] == "X")):
            self._state[self._module.ROWS.index(name)] = 0.0

    def __call__(self) -> None:
        nothing = self._state[:1] * 0.0
        self._module.run(
            self._state, self._coefficients, self._torque, nothing, nothing, self._ticks, 0
        )
