"""What touches the simulated device: stops that yield, a bearing that sticks, hands. Against closed
forms; and nothing of it where it is not asked for.
"""

from dataclasses import replace
from itertools import pairwise
from math import cos, exp, inf, pi, sin, sqrt

import numpy as np
import pytest
from support.boards import board_params
from support.models import servo_params

from hapticd.core.errors import ConfigError
from hapticd.mailbox import layout
from hapticd.mailbox.layout import Command, Value
from hapticd.model.composed import POSITION, VELOCITY
from hapticd.model.params import Ends, HandParams, TouchParams
from hapticd.model.step import SUBSTEPS_PER_TICK, make_plant
from hapticd.run.lockstep import LockStep, scene_params

DTYPE = np.dtype([tuple(field) for field in layout.TELEMETRY])
H_S = 1e-3 / SUBSTEPS_PER_TICK
MASS_KG = 0.008


def plant_of(touch, **changes):
    return make_plant(board_params(viscous_ns_per_m=0.0, touch=touch, **changes))


def flown(plant, state, substeps, force_n=0.0, level=0.0):
    states = [state]
    for _ in range(substeps):
        states.append(plant.step(states[-1], force_n, 0.0, level, 1))
    return states


@pytest.mark.parametrize("mass_kg", [0.005, 0.008])
@pytest.mark.parametrize("damping_ns_per_m", [0.0, 20.0])
@pytest.mark.parametrize("stiffness_n_per_m", [1e4, 1e5, 5e5, 2e6, 1e9])
def test_stop_of_any_stiffness_gains_no_energy_and_comes_to_rest(
    stiffness_n_per_m, damping_ns_per_m, mass_kg
):
    """Whatever part of a sub-step is left when the mass arrives."""
    touch = TouchParams(stiffness_n_per_m, damping_ns_per_m)
    for start_m in (0.0, 3e-6, 11e-6, 19e-6):
        plant = plant_of(touch, mass_kg=mass_kg, lower_stop_m=-1e-3, upper_stop_m=inf)
        speeds = [abs(v) for _, v in flown(plant, (start_m, -0.3), 400)]
        assert max(speeds) <= 0.3 * (1 + 1e-12)
        pushed = flown(plant, (start_m, -0.3), 4000, force_n=-0.5, level=1.0)[-1]
        assert pushed[1] == pytest.approx(0.0, abs=1e-6)
        assert pushed[0] == pytest.approx(-1e-3 - 0.5 / stiffness_n_per_m, abs=1e-9)


def test_rebound_of_an_undamped_stop_is_nearly_whole():
    plant = plant_of(TouchParams(1e4), lower_stop_m=0.0, upper_stop_m=inf)
    after = flown(plant, (1e-6, -0.1), 200)[-1]
    assert after[1] == pytest.approx(0.1, rel=0.1)


def test_stop_never_pulls():
    """A damper that the mass leaves faster than the spring follows would."""
    plant = plant_of(TouchParams(1e5, 200.0), lower_stop_m=0.0, upper_stop_m=inf)
    states = flown(plant, (-50e-6, 0.2), 50)
    assert all(v >= 0.2 for _, v in states)


def test_upper_stop_is_the_mirror_of_the_lower():
    touch = TouchParams(3e5, 15.0, coulomb_n=0.02, static_n=0.05)
    below = plant_of(touch, lower_stop_m=-1e-4, upper_stop_m=inf)
    above = plant_of(touch, lower_stop_m=-inf, upper_stop_m=1e-4)
    one = flown(below, (0.0, -0.1), 300, force_n=-0.4)
    other = flown(above, (0.0, 0.1), 300, force_n=0.4)
    assert [(-x, -v) for x, v in one] == other


def test_static_friction_holds_exactly_until_it_is_exceeded():
    touch = TouchParams(coulomb_n=0.1, static_n=0.3)
    plant = plant_of(touch)
    assert flown(plant, (0.0, 0.0), 1000, force_n=0.2999)[-1] == (0.0, 0.0)
    off = flown(plant, (0.0, 0.0), 16, force_n=0.301)[-1]
    t = 15 * H_S  # the first sub-step still breaks loose at the static level
    assert off[1] == pytest.approx((0.301 - 0.1) / MASS_KG * t, rel=0.02)


def test_sliding_mass_stops_where_coulomb_friction_says():
    plant = plant_of(TouchParams(coulomb_n=0.1, static_n=0.2))
    end = flown(plant, (0.0, 0.2), 1000)[-1]
    assert end[1] == 0.0
    assert end[0] == pytest.approx(MASS_KG * 0.2**2 / (2 * 0.1), rel=0.01)


def test_whole_pieces_slide_as_their_substeps_do():
    touch = TouchParams(coulomb_n=0.1, static_n=0.2)
    small = plant_of(touch)
    whole = plant_of(touch)
    single = flown(small, (0.0, 0.2), 96)[-1]
    state = (0.0, 0.2)
    for _ in range(24):
        state = whole.step(state, 0.0, 0.0, 0.0, 4)
    assert state == pytest.approx(single, rel=1e-12)


def test_slow_pull_by_a_spring_moves_it_in_jerks():
    """The slip under a spring k that pulls at the static level is 2 (Fs - Fc) / k, and as far as
    the spring's other end goes meanwhile.
    """
    static_n = 0.2
    coulomb_n = 0.1
    k = 200.0
    plant = plant_of(TouchParams(coulomb_n=coulomb_n, static_n=static_n))
    state = plant.rest(0.0)
    places = []
    for n in range(40_000):
        before = state
        state = plant.step(state, k * (1e-3 * n * H_S - state[0]), 0.0, 0.0, 1)
        if before[1] and not state[1]:
            places.append(state[0])
    slips = [b - a for a, b in pairwise([0.0, *places])]
    assert len(slips) >= 2
    expected = 2 * (static_n - coulomb_n) / k + 1e-3 * pi * sqrt(MASS_KG / k)
    assert slips == pytest.approx([expected] * len(slips), rel=0.01)


def test_held_handle_swings_about_the_place_where_it_was_grasped():
    hand = HandParams("hold", start_s=0.01, stiffness_n_per_m=500.0, damping_ns_per_m=1.0)
    plant = plant_of(TouchParams(hands=(hand,)))
    states = flown(plant, (0.0, 0.05), 160 + 320)
    grasped = states[160][0]
    assert grasped == pytest.approx(0.05 * 0.01, rel=1e-9)
    rate = 1.0 / (2 * MASS_KG)
    omega = sqrt(500.0 / MASS_KG - rate**2)
    t = 320 * H_S
    expected = 0.05 / omega * exp(-rate * t) * sin(omega * t)
    assert states[-1][0] - grasped == pytest.approx(expected, abs=0.03 * 0.05 / omega)
    assert cos(omega * t) != 0.0


def test_push_and_strike_give_their_impulse():
    push = HandParams("push", start_s=0.002, duration_s=0.01, force_n=0.4)
    strike = HandParams("strike", start_s=0.02, duration_s=0.004, force_n=3.0)
    plant = plant_of(TouchParams(hands=(push, strike)))
    states = flown(plant, (0.0, 0.0), 500)
    assert states[200][1] == pytest.approx(0.4 * 0.01 / MASS_KG, rel=1e-9)
    impulse_ns = 0.4 * 0.01 + 2 / pi * 3.0 * 0.004
    assert states[-1][1] == pytest.approx(impulse_ns / MASS_KG, rel=1e-3)


def composed(touch):
    _, board = scene_params("fig4")
    return replace(board, touch=touch)


def test_friction_of_the_composed_device_is_part_of_the_contact():
    """The calibrated device has 0.0293 N at its rotor: with 0.02 N more while it stands it breaks
    loose beyond 0.0493 N.
    """
    board = composed(TouchParams(static_n=0.02))
    level_n = sum(one.level_n for one in board.plant.contacts)
    assert level_n > 0.0
    plant = make_plant(board)
    held = plant.rest(0.0)
    moved = plant.rest(0.0)
    for _ in range(4000):
        held = plant.step(held, 0.0, level_n + 0.0199, 0.0, 4)
        moved = plant.step(moved, 0.0, level_n + 0.0201, 0.0, 4)
    assert held[:2] == (0.0, 0.0)
    assert moved[0] > 1e-4


def test_composed_device_without_touch_is_the_device_itself():
    plain = make_plant(composed(None))
    touched = make_plant(composed(TouchParams()))
    one = plain.rest(0.0)
    other = touched.rest(0.0)
    for n in range(2000):
        force = 0.3 * sin(0.02 * n)
        one = plain.step(one, force, 0.0, 0.0, 4)
        other = touched.step(other, force, 0.0, 0.0, 4)
    assert other == pytest.approx(one, rel=1e-6, abs=1e-9)


def test_stop_of_the_composed_device_yields():
    board = composed(TouchParams(1e5, 20.0))
    ends = Ends(-0.022, 0.022, POSITION, VELOCITY)
    plant = make_plant(replace(board, plant=replace(board.plant, ends=ends)))
    state = plant.rest(-0.02)
    for _ in range(2000):
        state = plant.step(state, 0.0, -0.5, 0.0, 4)
    assert state[0] == pytest.approx(-0.022 - (0.5 - 0.0293) / 1e5, abs=0.6e-6)
    assert state[1] == pytest.approx(0.0, abs=1e-6)


def test_hand_holds_the_handle_on_the_whole_stack():
    """1 N of the virtual wall against a hand of 2000 N/m."""
    hand = HandParams("hold", stiffness_n_per_m=2000.0, damping_ns_per_m=5.0)
    with LockStep(servo_params(), board_params(touch=TouchParams(hands=(hand,)))) as stack:
        stack.run(5)
        wall = {Value.WALL_STIFFNESS: 100.0, Value.WALL_POSITION: -0.01, Value.WALL_SIDE: 1.0}
        stack.do(Command.SET, wall)
        stack.do(Command.ENABLE)
        flown = np.frombuffer(stack.run(1000), DTYPE)
    assert flown["position_m"][-1] == pytest.approx(-1.0 / 2100.0, abs=1e-6)


@pytest.mark.parametrize(
    ("touch", "message"),
    [
        (TouchParams(coulomb_n=0.2, static_n=0.1), "static_n"),
        (TouchParams(stop_stiffness_n_per_m=-1.0), "stop_stiffness_n_per_m"),
        (TouchParams(hands=(HandParams("pat"),)), "hold, push, strike"),
        (TouchParams(hands=(HandParams("push", force_n=inf),)), "finite"),
        (TouchParams(hands=(HandParams("hold", damping_ns_per_m=-1.0),)), "passive"),
    ],
)
def test_impossible_touch_is_refused(touch, message):
    with pytest.raises(ConfigError, match=message):
        plant_of(touch)
