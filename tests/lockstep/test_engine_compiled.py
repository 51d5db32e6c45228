"""The law inside the kernels is `render` itself: bit for bit on what the trials recorded."""

import numpy as np
import pytest
from support.devices import COUNTS, DRY, LIMIT, RIGID, TWO_MASSES, device
from support.models import environment_tuple

from hapticd.core.environment import Environment, FilterParams, WallParams, WorkspaceParams
from hapticd.model.effects import Saturation, Viscous
from hapticd.model.scene import Excitation
from hapticd.render.law import at_rest, design_coefficients, render
from hapticd.zwidth.engine.batch import simulate

TRIALS = [[100.0, 1.0, 0.010], [50.0, 2.0, 0.0], [600.0, 0.5, -0.002], [5000.0, 8.0, 0.001]]
SOLID = Environment(
    velocity_filter=FilterParams(120.0, 1.1, "matched"),
    wall=WallParams(
        stiffness_n_per_m=3000.0, virtual_damping_ns_per_m=2.0, position_m=3e-5, side=1
    ),
    workspace=WorkspaceParams(-4e-5, 6e-5, 900.0),
)


def replayed(positions, kbm, environment, limit_n, scalar):
    """Forces of `render` in CPython over `positions`, all numbers of type `scalar`."""
    params = Environment(
        *kbm,
        environment.velocity_filter,
        environment.acceleration_filter,
        environment.wall,
        environment.workspace,
    )
    numbers = tuple(scalar(value) for value in environment_tuple(params, limit_n))
    designed = design_coefficients(
        environment.velocity_filter, environment.acceleration_filter, 1000.0
    )
    coefficients = tuple(scalar(value) for value in designed)
    state = tuple(scalar(value) for value in at_rest(0.0))
    forces = []
    for x in positions:
        force, *_, state = render(scalar(x), state, numbers, coefficients)
        forces.append(force)
    return np.array(forces, dtype=scalar)


@pytest.mark.parametrize(("dtype", "scalar"), [("f64", np.float64), ("f32", np.float32)])
@pytest.mark.parametrize("environment", [Environment(), SOLID], ids=["plain", "wall and ends"])
def test_forces_equal_cpython_to_the_bit(environment, dtype, scalar):
    model = device(*TWO_MASSES, DRY, COUNTS, Saturation(limit_n=0.4))
    result = simulate(model, TRIALS, 2.0, environment=environment, dtype=dtype, keep="ticks")
    limited = 0
    for trial, kbm in enumerate(TRIALS):
        positions = result.position_m[trial]
        forces = result.force_n[trial]
        expected = replayed(positions, kbm, environment, 0.4, scalar)
        assert forces.tobytes() == expected.astype(forces.dtype).tobytes()
        limited += int((abs(forces) == scalar(0.4)).sum())
    assert limited > 100


def test_force_stays_finite_and_limited_when_the_motion_runs_away():
    model = device(*RIGID, Viscous(rotor_ns_per_m=0.3), LIMIT)
    wild = simulate(
        model, [[0.0, 0.0, -0.05]], 2.0, excitation=Excitation("push", force_n=50.0), keep="ticks"
    )
    assert np.isfinite(wild.force_n).all()
    assert wild.max_force_n[0] == 8.0
