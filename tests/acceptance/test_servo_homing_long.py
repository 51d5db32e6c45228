"""Homing finds the stop or the index, or says that it did not: over stiffness, friction, hands, a
motor without power, and 50 seeds of all of them.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from support.boards import board_params
from support.homing_rig import HOME, Rig, seeded
from support.models import COUNT_M, COUNT_N, device_params, servo_params
from test_servo_homing import INDEX, STOP_M, damped, held, why

from hapticd.core.faults import BY_NUMBER
from hapticd.core.params import ScaleParams
from hapticd.mailbox.layout import Command, Result
from hapticd.model.composed import POSITION, VELOCITY
from hapticd.model.params import Ends, HandParams, TouchParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep, scene_params
from hapticd.servo.homing import FASTEST
from hapticd.servo.safety import State

# --- all of it by seed ----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 50, 10))
def test_homing_finds_the_stop_or_says_that_it_did_not(first):
    """No seed is falsely homed; most of those that nobody touches are homed."""
    quick = replace(HOME, timeout_s=7.0)
    undisturbed = []
    for seed in range(first, first + 10):
        case = seeded(seed)
        board = {"mass_kg": case.mass_kg, "lower_stop_m": case.stop_m, "upper_stop_m": 0.022}
        found = Rig(quick, case.touch, **board).home(case.stop_m)
        assert found.state is (State.DISABLED if found.homed else State.FAULT), (seed, case.what)
        assert not found.homed or abs(found.error_m) <= 100e-6, (seed, case.what)
        if " none " in case.what:
            undisturbed.append(found.homed)
    assert undisturbed.count(True) >= 0.6 * len(undisturbed)


CARRIED = replace(HOME, current_n_per_a=1.65)


@pytest.mark.parametrize(("coulomb_n", "static_n"), [(0.0293, 0.04), (0.1, 0.2), (0.15, 0.3)])
def test_push_is_kept_through_stick_slip(coulomb_n, static_n):
    """22 mm at 10 mm/s, twice the load and the way back, within the ten seconds of the default."""
    touch = damped(1e5, coulomb_n=coulomb_n, static_n=static_n)
    found = Rig(HOME, touch, lower_stop_m=-0.022).home(-0.022)
    assert found.homed
    assert found.error_m == pytest.approx(0.0, abs=10e-6)


def test_stop_is_found_in_the_other_direction_and_with_the_other_sign():
    home = replace(HOME, direction=1, position_m=0.004)
    found = Rig(home, damped(1e5), upper_stop_m=0.005).home(0.005)
    assert found.error_m == pytest.approx(-5e-6, abs=2 * COUNT_M)
    # x rises as counts fall: the same stop lies at the other end of x
    device = device_params(home=replace(HOME, position_m=-0.004), position=ScaleParams(COUNT_M, -1))
    rig = Rig(HOME, damped(1e5), gain=-1.0, upper_stop_m=0.005, device=device)
    assert rig.home(0.005).homed
    assert -COUNT_M * (0.005 / COUNT_M - rig.plan.origin) == pytest.approx(-0.004 + 5e-6, abs=1e-6)


def test_calibrated_device_homes_in_lock_step():
    """0.0293 N of friction, 5 ms of lag, two masses; its stops yield."""
    servo, board = scene_params("fig4")
    ends = Ends(-0.012, 0.022, POSITION, VELOCITY)
    board = replace(board, plant=replace(board.plant, ends=ends), touch=damped(1e5))
    device = replace(servo.device, home=replace(HOME, position_m=-0.012))
    with LockStep(replace(servo, device=device), board) as stack:
        stack.run(5)
        assert stack.do(Command.HOME).result is Result.APPLIED
        flown = as_records(stack.run(6000))
    assert flown["state"][-1] == State.DISABLED
    assert flown["homed"][-1] == 1
    stopped = flown["position_m"][np.argmax(flown["homed"] == 1)]
    assert stopped == pytest.approx(-0.012, abs=10e-6)


@pytest.mark.parametrize("friction_n", [0.0, 0.1])
@pytest.mark.parametrize("stiffness_n_per_m", [30, 100, 300, 1000, 1e4])
def test_held_handle_is_never_taken_for_the_stop(stiffness_n_per_m, friction_n):
    touch = held(stiffness_n_per_m, coulomb_n=friction_n, static_n=2 * friction_n)
    found = Rig(replace(HOME, timeout_s=4.0), touch, lower_stop_m=-0.02).home(-0.02)
    assert found.state is State.FAULT
    assert not found.homed
    assert why(found) in ("home_failed", "home_blocked", "home_not_confirmed")


@pytest.mark.parametrize(
    ("mass_kg", "stiffness_n_per_m", "damping_ns_per_m", "coulomb_n", "static_n"),
    [
        (5.835811715e-3, 377.25678, 1.738204, 0.0379010, 0.1390681),
        (7.533794e-3, 166.42729, 1.087613, 0.0434102, 0.3338141),
    ],
)
def test_soft_hand_that_friction_hides_is_felt_by_the_work(
    mass_kg, stiffness_n_per_m, damping_ns_per_m, coulomb_n, static_n
):
    """The handle stands in the hand, slips back to the very same place, and lets the back-off
    pass: only the mean force beside friction tells.
    """
    hand = HandParams(
        "hold", stiffness_n_per_m=stiffness_n_per_m, damping_ns_per_m=damping_ns_per_m
    )
    touch = TouchParams(1e5, 5.0, coulomb_n, static_n, (hand,))
    found = Rig(HOME, touch, mass_kg=mass_kg, lower_stop_m=-0.02).home(-0.02)
    assert (found.homed, why(found)) == (False, "home_not_confirmed")


def test_hand_that_lets_go_between_the_two_finds_is_told():
    found = Rig(HOME, held(1e4, duration_s=1.1), lower_stop_m=STOP_M).home(STOP_M)
    assert not found.homed
    assert why(found) == "home_not_confirmed"


@pytest.mark.parametrize("gain", [0.0, 0.4])
def test_motor_without_its_current_finds_no_stop(gain):
    found = Rig(CARRIED, damped(1e5), gain=gain, lower_stop_m=STOP_M).home(STOP_M)
    assert (found.homed, why(found)) == (False, "home_no_current")
    assert Rig(CARRIED, damped(1e5), lower_stop_m=STOP_M).home(STOP_M).homed


@pytest.mark.parametrize(
    "touch",
    [
        damped(1e5, coulomb_n=0.1, static_n=0.3),
        held(1e4, duration_s=1.0),
        held(100.0, duration_s=3.0),
    ],
)
def test_force_and_speed_are_bounded_whatever_is_in_the_way(touch):
    """Let go at once at the whole push: `FASTEST` times the speed, and what the force does to the
    mass within two ticks.
    """
    found = Rig(HOME, touch, lower_stop_m=-0.02).home(-0.02)
    assert found.worst_n <= HOME.force_n + COUNT_N
    limit = FASTEST * HOME.speed_m_per_s + HOME.force_n / 0.008 * 2e-3
    assert found.fastest_m_per_s < limit


def test_held_handle_is_told_on_the_whole_stack():
    params = servo_params(device=device_params(home=HOME))
    with LockStep(params, board_params(lower_stop_m=-0.02, touch=held(2000.0))) as stack:
        stack.run(5)
        assert stack.do(Command.HOME).result is Result.APPLIED
        flown = as_records(stack.run(10_100))
    assert flown["state"][-1] == State.FAULT
    assert BY_NUMBER[flown["fault"][-1]].code == "home_failed"
    assert not flown["homed"].any()


def test_authority_that_flickers_starts_the_push_anew():
    rig = Rig(HOME, damped(1e5), granted=lambda tick: tick not in (900, 901), lower_stop_m=STOP_M)
    rig.fly()
    rig.fly(Command.HOME)
    while rig.tick < 902:
        rig.fly()
    assert rig.force_n == 0.0
    while rig.plan.state is State.HOMING:
        rig.fly()
    assert max(abs(b - a) for a, b in pairwise(rig.forces[903:-1])) < 0.05
    assert rig.plan.homed


def test_failed_homing_lets_go_in_twenty_ticks():
    rig = Rig(replace(HOME, timeout_s=2.0), held(500.0))
    assert not rig.home(STOP_M).homed
    end = len(rig.forces)
    for _ in range(25):
        rig.fly()
    assert abs(rig.forces[end - 2]) > 0.2
    assert max(abs(b - a) for a, b in pairwise(rig.forces[end - 2 :])) < 0.5 / 20 + 2 * COUNT_N
    assert rig.forces[-1] == 0.0


def test_filter_that_a_client_has_set_does_not_reach_homing():
    slow = replace(servo_params().environment.velocity_filter, frequency_hz=0.1)
    rig = Rig(HOME, damped(1e5), lower_stop_m=STOP_M)
    settled = rig.state[0]
    plan = settled.plan._replace(filters=(slow, settled.plan.filters[1]))
    rig.state = (replace(settled, plan=plan), *rig.state[1:])
    assert rig.home(STOP_M).error_m == pytest.approx(5e-6, abs=2 * COUNT_M)


def test_index_that_never_comes_fails_after_both_stops():
    found = Rig(INDEX, damped(1e5), lower_stop_m=STOP_M, upper_stop_m=0.005, mark_m=0.1).home(0.1)
    assert (found.homed, why(found)) == (False, "home_failed")
    assert found.ticks < 5000


@pytest.mark.parametrize(("mass_kg", "ratio"), [(0.005, 0.0), (0.008, 0.3)])
@pytest.mark.parametrize("stiffness_n_per_m", [1e4, 1e5, 5e5, 2e6])
def test_stop_of_any_stiffness_is_found(stiffness_n_per_m, ratio, mass_kg):
    touch = damped(stiffness_n_per_m, ratio, mass_kg)
    found = Rig(HOME, touch, mass_kg=mass_kg, lower_stop_m=STOP_M).home(STOP_M)
    assert found.homed
    assert found.error_m == pytest.approx(0.5 / stiffness_n_per_m, abs=2 * COUNT_M)
