"""Homing finds the stop or the index, or says that it did not: over stiffness, friction, hands, a
motor without power, and 50 seeds of all of them.
"""

from dataclasses import replace
from math import inf

import pytest
from support.boards import board_params
from support.flight import HEALTHY
from support.homing_rig import HOME, Rig
from support.models import COUNT_M, COUNT_N, device_params, servo_params

from hapticd.core.faults import BY_CODE, BY_NUMBER
from hapticd.mailbox.layout import Command, Result, Value
from hapticd.model.params import HandParams, InjectionParams, TouchParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import flatten, unflatten
from hapticd.servo.safety import State

STOP_M = -0.005
INDEX = replace(HOME, method="index")


def damped(stiffness_n_per_m, ratio=0.05, mass_kg=0.008, **friction):
    damping = 2.0 * ratio * (stiffness_n_per_m * mass_kg) ** 0.5
    return TouchParams(stiffness_n_per_m, damping, **friction)


def held(stiffness_n_per_m, start_s=0.0, duration_s=1e9, **friction):
    hand = HandParams(
        "hold",
        start_s,
        duration_s,
        stiffness_n_per_m=stiffness_n_per_m,
        damping_ns_per_m=3.0,
    )
    return TouchParams(1e5, 5.0, hands=(hand,), **friction)


def why(found):
    return BY_NUMBER[found.fault].code


# --- what is found --------------------------------------------------------------------------------


def test_inelastic_stop_is_found_to_a_count():
    found = Rig(HOME, lower_stop_m=STOP_M).home(STOP_M)
    assert found.error_m == pytest.approx(0.0, abs=COUNT_M)


@pytest.mark.parametrize("static_n", [0.0, 0.15])
def test_start_at_the_stop_is_found(static_n):
    touch = damped(1e5, coulomb_n=static_n, static_n=static_n)
    found = Rig(HOME, touch, lower_stop_m=0.0).home(0.0)
    assert found.homed
    assert found.error_m == pytest.approx(0.0, abs=10e-6)


@pytest.mark.parametrize("mark_m", [-0.003, 0.003])
def test_index_is_found_on_either_side_and_confirmed(mark_m):
    """Towards the stop, or behind the start: then the search turns round at the stop."""
    found = Rig(INDEX, damped(1e5), mark_m=mark_m, lower_stop_m=STOP_M).home(mark_m)
    assert found.homed
    assert found.error_m == pytest.approx(0.0, abs=2 * COUNT_M)


def test_index_that_is_elsewhere_the_second_time_is_not_taken():
    rig = Rig(INDEX, mark_m=-0.003, lower_stop_m=STOP_M)
    rig.fly()
    rig.fly(Command.HOME)
    while rig.plan.homing.phase == 0:
        rig.fly()
    rig.mark_m = -0.0035
    while rig.plan.state is State.HOMING:
        rig.fly()
    assert rig.plan.fault == BY_CODE["home_not_confirmed"].number


# --- what is not --------------------------------------------------------------------------------


def test_friction_beyond_the_force_is_no_stop():
    found = Rig(HOME, damped(1e5, coulomb_n=0.3, static_n=0.6), lower_stop_m=STOP_M).home(STOP_M)
    assert (found.homed, why(found)) == (False, "home_blocked")


@pytest.mark.parametrize("since", [0, 400, 1300])
def test_board_without_authority_ends_homing(since):
    """From the start, on the way, and while the stop is pressed."""
    rig = Rig(HOME, damped(1e5), granted=lambda tick: tick < since, lower_stop_m=STOP_M)
    found = rig.home(STOP_M)
    assert (found.homed, why(found)) == (False, "no_authority")


def test_amplifier_of_wrong_polarity_is_told_within_milliseconds():
    found = Rig(HOME, damped(1e5), gain=-1.0, lower_stop_m=-0.02, upper_stop_m=0.02).home(-0.02)
    assert (found.homed, why(found)) == (False, "home_wrong_way")
    assert abs(found.where_m) < 3 * HOME.back_off_m


def test_search_without_end_is_a_fault_in_time():
    found = Rig(replace(HOME, timeout_s=2.0)).home(STOP_M)
    assert (found.homed, why(found)) == (False, "home_failed")
    assert found.ticks == pytest.approx(2000, abs=5)


# --- force and speed ------------------------------------------------------------------------------


def test_stop_after_a_flicker_of_authority_renders_nothing_but_the_fading_push():
    """The law's gain has no part in homing: with K = 500 N/m and 3 mm, 1.5 N would act."""
    rig = Rig(HOME, granted=lambda tick: tick not in (400, 401))
    values = [0.0] * 20
    values[Value.MASK] = float(1 << Value.STIFFNESS | 1 << Value.RAMP_S)
    values[Value.STIFFNESS] = 500.0
    rig.fly()
    command = ((1, int(Command.SET), 9, 0, tuple(values)),)
    rig.state, _ = rig.step(rig.state, command, (0, 0, 2500, 0, HEALTHY, 0, 0.1, 0, 0), rig.tick)
    rig.tick += 1
    rig.fly(Command.HOME)
    while rig.tick < 700:
        rig.fly()
    assert abs(rig.body[0]) > 2e-3
    pushed_n = abs(rig.force_n)
    rig.fly(Command.STOP)
    for _ in range(30):
        rig.fly()
    assert max(map(abs, rig.forces[700:])) <= pushed_n + COUNT_N


def test_checkpoint_in_the_middle_goes_on_bit_by_bit():
    rig = Rig(HOME, damped(1e5), lower_stop_m=STOP_M)
    rig.fly()
    rig.fly(Command.HOME)
    while rig.tick < 1500:
        rig.fly()
    assert unflatten(flatten(rig.state)) == rig.state


# --- the whole stack ------------------------------------------------------------------------------


def test_emergency_stop_in_the_middle_of_homing_is_no_stop():
    injections = (InjectionParams("emergency_stop", tick=300, value=0.5),)
    params = servo_params(device=device_params(home=replace(HOME, required=True)))
    board = board_params(lower_stop_m=-0.02, upper_stop_m=inf, injections=injections)
    with LockStep(params, board) as stack:
        stack.run(5)
        assert stack.do(Command.HOME).result is Result.APPLIED
        flown = as_records(stack.run(1500))
        assert flown["fault"][-1] == BY_CODE["no_authority"].number
        assert not flown["homed"].any()
        assert stack.do(Command.RESET).result is Result.APPLIED
        assert stack.do(Command.ENABLE).result is Result.REFUSED_NOT_HOMED
