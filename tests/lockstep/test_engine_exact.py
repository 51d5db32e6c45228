"""The engine against the same model in long double, step by step: exact for what is linear, and
for what is not.
"""

import numpy as np
import pytest
from support.devices import (
    COGS,
    COUNTS,
    DRY,
    ENDS,
    HAND,
    RIGID,
    SPRING,
    STAR,
    TWO_MASSES,
    device,
    rigid,
)
from support.engine_exact import largest_error

from hapticd.core.environment import Environment, FilterParams, WallParams, WorkspaceParams
from hapticd.model.effects import AntiAlias, VelocityHighpass
from hapticd.zwidth.engine.batch import simulate


@pytest.mark.parametrize("delay", [0.0, 0.125, 0.4, 1.0, 1.45, 2.0])
def test_delay_of_any_length_is_exact(delay):
    assert largest_error(device(*TWO_MASSES, delay=delay)) < 1e-12


@pytest.mark.parametrize("substeps", [1, 4])
def test_linear_device_with_microsecond_electronics_is_exact(substeps):
    assert largest_error(device(*STAR), level=1.74, substeps=substeps) < 1e-12


@pytest.mark.parametrize(
    "model",
    [
        rigid(),
        device(*RIGID, SPRING),
        device(*TWO_MASSES, HAND),
        device(*TWO_MASSES, VelocityHighpass(corner_hz=10.0)),
    ],
    ids=["rigid", "spring to ground", "hand", "high-pass"],
)
def test_linear_device_is_exact(model):
    assert largest_error(model) < 1e-12


def test_what_is_not_needed_is_not_computed_and_not_missed():
    model = device(*STAR)
    assert largest_error(model, level=0.0) < 1e-12


@pytest.mark.parametrize("extra", [(COGS,), (ENDS,)], ids=["cogging", "ends"])
def test_position_dependent_forces_are_as_defined(extra):
    assert largest_error(device(*TWO_MASSES, *extra), substeps=2) < 1e-10


def test_servo_rate_filters_walls_and_ends_reach_the_law():
    wall = WallParams(
        stiffness_n_per_m=2000.0, virtual_damping_ns_per_m=1.0, position_m=1e-4, side=1
    )
    environment = Environment(
        velocity_filter=FilterParams(200.0, 1.0, "matched"),
        wall=wall,
        workspace=WorkspaceParams(-2e-4, 1.5e-4, 800.0),
    )
    assert largest_error(device(*TWO_MASSES, rate_hz=2000.0), environment=environment) < 1e-11


def test_trial_starts_where_it_is_told():
    assert largest_error(device(*STAR, COUNTS), level=1.0, start=(0.001, 0.05)) < 1e-12


def test_single_precision_follows_double_to_its_digits():
    assert largest_error(device(*STAR, DRY), level=1.74, dtype="f32") < 1e-5


def test_anti_alias_filter_delays_torque_and_velocity_alike():
    """A rigid free mass: filtered force and velocity still have the ratio m s, so work over a
    period of a sine is 0.
    """
    model = device(*RIGID, AntiAlias(corner_hz=800.0), delay=0.0)
    torque = 0.1 * np.sin(2 * np.pi * 100.0 * np.arange(4000) / 4000)
    result = simulate(model, [[0, 0, 0]], 1.0, excitation=torque, keep="records")
    force = result.torque_n[0][2000:]
    velocity = result.velocity_m_per_s[0][2000:]
    phases = np.array(
        [
            np.exp(-2j * np.pi * 100.0 * np.arange(2000) / 4000) @ signal
            for signal in (force, velocity)
        ]
    )
    assert abs(phases[0] / phases[1] / (1j * 2 * np.pi * 100.0 * 0.008) - 1.0) < 3e-3
    assert abs(phases[0]) < 0.999 * 0.1 * 1000
