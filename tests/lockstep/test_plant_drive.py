"""Limits of current and voltage on command and active damping together: closed forms, the same in
both backends, bounded in an impact, and no trace where a scene does not ask for them.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.devices import COUNTS, DRY, LIMIT, MOTOR, STAR, WEAK, device
from support.engine_exact import TORQUE
from support.impact import LIMITS, SPEEDS, impact, stays_bounded
from support.plant_composed import board
from support.straight import Straight

from hapticd.core.environment import Environment
from hapticd.core.errors import ConfigError
from hapticd.model.compose import compose_device
from hapticd.model.effects import Amplifier, AmplifierLimits, Crowbar, DampingCircuit, Masses
from hapticd.model.step import make_plant
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.engine.shape import reduced, shape_of
from hapticd.zwidth.engine.source import kernel_source

N_PER_A = MOTOR.torque_constant_nm_per_a / MOTOR.lever_m
AROUND_OHM = MOTOR.resistance_ohm + LIMITS.series_ohm
FAR = AmplifierLimits(max_current_a=1e4, max_voltage_v=1e4, series_ohm=0.0, inductance_h=1e-9)
LAGS = (Amplifier(bandwidth_hz=5e3), DampingCircuit(bandwidth_hz=1e3))
HEAVY = (Masses(rotor_kg=1e10), MOTOR, *LAGS)  # keeps its speed
SUBSTEP_S = 1e-3 / 16


@cache
def heavy_plant(limits=LIMITS):
    """The simulated board's, exact at the levels of these tests."""
    return make_plant(board(compose_device("heavy", (*HEAVY, limits)), (0.0, 1.74, 5.0)))


def force_at(speed_m_per_s, command_n, level_ns_per_m):
    """Motor force [N] after 10 ms at a speed that lasts, by the simulated board."""
    plant = heavy_plant()
    state = list(plant.rest(0.0))
    state[1] = speed_m_per_s
    state = tuple(state)
    for _ in range(160):
        state = plant.step(state, command_n, 0.0, level_ns_per_m, 1)
    return plant.motor_force(state, command_n, level_ns_per_m)


# --- closed forms ---------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [-3.0, -0.5, 0.0, 0.5, 1.0, 3.0, 6.0])
@pytest.mark.parametrize(("command", "level"), [(-8.0, 5.0), (0.0, 1.74), (8.0, 0.0)])
def test_at_a_speed_that_lasts_force_is_what_is_asked_inside_both_limits(speed, command, level):
    asked = command - level * speed
    current = np.clip(asked, -N_PER_A * 6.0, N_PER_A * 6.0)
    supply = [
        N_PER_A * (u - N_PER_A * speed) / AROUND_OHM
        for u in (-LIMITS.max_voltage_v, LIMITS.max_voltage_v)
    ]

    assert force_at(speed, command, level) == pytest.approx(np.clip(current, *supply), rel=1e-9)


def test_delivered_damping_vanishes_beyond_the_speed_at_which_nothing_is_left_for_it():
    """At the limit of 9.9 N, with 8 N commanded, 1.9 N are left: 0.38 m/s at 5 N s/m."""
    level = 5.0
    left_n = N_PER_A * 6.0 - 8.0
    for speed, delivered in ((0.9 * left_n / level, level), (1.1 * left_n / level, 0.0)):
        slope = (force_at(speed + 1e-3, -8.0, level) - force_at(speed, -8.0, level)) / 1e-3
        assert -slope == pytest.approx(delivered, abs=1e-6)


def test_at_the_limit_of_voltage_the_shorted_winding_still_damps():
    speed = (LIMITS.max_voltage_v + AROUND_OHM * 6.0) / N_PER_A + 1.0
    slope = (force_at(speed + 1e-3, 8.0, 5.0) - force_at(speed, 8.0, 5.0)) / 1e-3

    assert -slope == pytest.approx(N_PER_A**2 / AROUND_OHM, rel=1e-6)


def test_supply_and_inductance_limit_how_fast_the_current_rises():
    """A step of 8 N from a still rotor: L i' = u - R i until it is there."""
    slow = replace(LIMITS, inductance_h=1e-3)
    plant = heavy_plant(slow)
    state = plant.rest(0.0)
    for k in range(1, 5):
        state = plant.step(state, 8.0, 0.0, 0.0, 1)
        end_n = N_PER_A * slow.max_voltage_v / AROUND_OHM
        rising = end_n * (1.0 - np.exp(-k * SUBSTEP_S * AROUND_OHM / slow.inductance_h))
        assert plant.motor_force(state, 8.0, 0.0) == pytest.approx(rising, rel=1e-9)


# --- both backends --------------------------------------------------------------------------------


@pytest.mark.parametrize("level", [0.0, 1.74])
def test_engine_solves_them_as_defined(level):
    model = device(*STAR, DRY, COUNTS, LIMIT, WEAK)
    asked = [[100.0, 1.0, 0.01]]
    found = simulate(
        model, asked, 0.1, excitation=TORQUE, active_damping=level, substeps=4, keep="ticks"
    )
    velocity, force, _ = Straight(model, asked[0], None, level, 4).play(TORQUE)

    assert abs(found.velocity_m_per_s[0] - velocity).max() < 1e-11 * abs(velocity).max()
    assert abs(found.force_n[0] - force).max() < 1e-11 * abs(force).max()
    assert found.limited[0] > 0.2


def test_limits_that_nothing_reaches_change_no_bit():
    asked = [[100.0, 1.0, 0.01]]
    bits = []
    for extra in ((), (FAR,)):
        found = simulate(
            device(*STAR, DRY, *extra), asked, 0.1, excitation=TORQUE, active_damping=1.74,
            substeps=4, keep="ticks",
        )  # fmt: skip
        bits.append((found.velocity_m_per_s.tobytes(), found.force_n.tobytes()))

    assert bits[0] == bits[1]
    assert found.limited[0] == 0.0


def test_without_them_neither_backend_has_an_instruction_for_them():
    plain, _ = reduced(device(*STAR, DRY), damped=True)
    weak, _ = reduced(device(*STAR, DRY, WEAK), damped=True)
    text, more = (
        kernel_source(shape_of(model, Environment(), True, 4, "f64")) for model in (plain, weak)
    )

    assert plain.drive is None
    assert ("LIMITED" in text, "LIMITED" in more) == (False, True)
    assert "amplifier" not in board(device(*STAR, DRY)).plant.columns
    assert simulate(device(*STAR, DRY), [[0.0, 0.0, 0.0]], 0.1).limited is None


def test_share_of_ticks_at_a_limit_is_counted():
    """The first fifth of a trial is pushed so that the damping asks for more than there is."""
    push = np.zeros(4000)
    push[:800] = 40.0
    found = simulate(
        device(*STAR, LIMITS), [[0.0, 0.0, 0.0]], 1.0, excitation=push, active_damping=5.0
    )

    assert 0.19 < found.limited[0] < 0.22


# --- an impact ------------------------------------------------------------------------------------


@pytest.mark.parametrize("substeps", [1, 4])
def test_impact_on_a_stiff_wall_at_full_active_damping_stays_bounded(substeps):
    for speed in SPEEDS:
        stays_bounded(impact(speed, substeps), speed)


# --- refusals -------------------------------------------------------------------------------------


def test_limits_need_an_amplifier_with_a_lag():
    with pytest.raises(ConfigError, match="add the effect 'amplifier'"):
        device(*STAR[:6], LIMITS)


def test_a_shorted_motor_has_no_amplifier_to_limit():
    with pytest.raises(ConfigError, match="leave out 'amplifier', 'amplifier_limits'"):
        device(*STAR[:5], Crowbar(), LIMITS)


def test_a_step_that_is_too_long_for_the_level_is_refused():
    light = device(Masses(rotor_kg=0.0003), MOTOR, *LAGS, LIMITS)
    asked = {"params": [[0.0, 0.0, 0.0]], "seconds": 0.1, "active_damping": 5.0}
    with pytest.raises(ConfigError, match="use more sub-steps"):
        simulate(light, substeps=1, **asked)
    assert simulate(light, substeps=4, **asked).samples[0] == 400
