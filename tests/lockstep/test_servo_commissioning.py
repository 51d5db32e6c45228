"""Until signs are verified a device has a tenth of its force and a box, and every push is watched.

The board behind is the simulated one: its truth may differ from what the device file says.
"""

import dataclasses

import numpy as np
import pytest
from support.boards import board_params
from support.flight import Flight
from support.models import COUNT_M, COUNT_N, device_params, servo_params

from hapticd.core.environment import Environment, WorkspaceParams
from hapticd.core.faults import BY_CODE
from hapticd.core.params import HomeParams, ScaleParams
from hapticd.mailbox.layout import COMMISSIONING, Command, Result, State, Value
from hapticd.protocol.limits import CommandLimits
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import flatten, unflatten
from hapticd.servo.safety import Push, followed, push_ended

FAULT = BY_CODE["commissioning"].number
FAR = {Value.WALL_STIFFNESS: 5.0, Value.WALL_POSITION: -0.1, Value.WALL_SIDE: 1.0}  # -0.5 N at 0


def unverified(**device):
    return servo_params(device=device_params(commissioning=True, **device))


def pushed(params, wall, ticks=2000, **board):
    """Records of a free handle after an enable into a far and weak wall."""
    with LockStep(params, board_params(**board)) as stack:
        stack.run(5)
        stack.do(Command.SET, {**wall, Value.RAMP_S: 0.0})
        stack.do(Command.ENABLE)
        return as_records(stack.run(ticks))


@pytest.mark.parametrize(
    ("place", "inside", "outside"),
    [
        (Value.STIFFNESS, 100.0, 101.0),
        (Value.STIFFNESS, 0.0, -1.0),
        (Value.VIRTUAL_DAMPING, 2.0, 2.1),
        (Value.VIRTUAL_DAMPING, 0.0, -0.1),
        (Value.MASS, 0.0, 0.001),
        (Value.WALL_STIFFNESS, 100.0, 101.0),
        (Value.WALL_VIRTUAL_DAMPING, 2.0, 2.1),
    ],
)
def test_only_a_box_is_taken_until_signs_are_verified(place, inside, outside):
    flight = Flight(unverified())
    assert flight.do(Command.SET, {place: inside}) is Result.APPLIED
    assert flight.do(Command.SET, {place: outside}) is Result.REFUSED_RANGE
    verified = Flight(servo_params())
    assert verified.do(Command.SET, {place: outside}) in (Result.APPLIED, Result.REFUSED_RANGE)
    if outside > 0.0:
        assert verified.do(Command.SET, {place: outside}) is Result.APPLIED


def test_what_is_out_of_the_box_is_refused_with_the_reason_and_the_way_out():
    (said,) = CommandLimits.announced(unverified()).broken_by({"K": 300.0})
    assert "0..100 N/m" in said["msg"]
    assert "not verified" in said["msg"]
    assert "hapticd rig motor" in said["msg"]
    assert not CommandLimits.announced(servo_params()).broken_by({"K": 300.0})


def test_a_configuration_beyond_the_box_begins_at_its_edge():
    environment = Environment(stiffness_n_per_m=500.0, virtual_damping_ns_per_m=5.0, mass_kg=0.1)
    params = dataclasses.replace(unverified(), environment=environment)
    flight = Flight(params)
    values = flight.state[0].plan.values
    assert values[Value.STIFFNESS].end == 100.0
    assert values[Value.VIRTUAL_DAMPING].end == 2.0
    assert values[Value.MASS].end == 0.0


def test_soft_ends_do_not_push_where_nobody_knows_the_side():
    ends = WorkspaceParams(lower_m=0.001, upper_m=0.002, stiffness_n_per_m=1000.0)
    environment = Environment(workspace=ends)
    found = pushed(dataclasses.replace(unverified(), environment=environment), {}, 800)
    assert not found["force_n"].any()
    known = dataclasses.replace(servo_params(), environment=environment)
    assert pushed(known, {}, 800)["force_n"].any()


def test_homing_is_refused_until_signs_are_verified():
    home = HomeParams(method="stop")
    assert Flight(unverified(home=home)).do(Command.HOME) is Result.REFUSED_COMMISSIONING
    assert Flight(servo_params(device=device_params(home=home))).do(Command.HOME) is Result.APPLIED


def test_a_push_ends_where_the_handle_went_10_mm_with_it():
    found = pushed(unverified(), FAR, lower_stop_m=-0.5)
    tripped = np.flatnonzero(found["fault"] == FAULT)[0]
    assert found["position_m"][tripped] == pytest.approx(-0.010, abs=0.5e-3)
    assert not found["force_n"][tripped + 20 :].any()


def test_a_wrong_sign_ends_the_push_within_20_ms_of_its_work_against_the_force():
    """Work against the force beyond that of its largest in 0.5 mm, then 20 ms of fading."""
    wrong = unverified(force=ScaleParams(COUNT_N, sign=-1))
    found = pushed(wrong, FAR, upper_stop_m=0.5)
    tripped = np.flatnonzero(found["fault"] == FAULT)[0]
    work_j = -np.cumsum(found["force_n"][:-1] * np.diff(found["position_m"]))
    most_n = np.maximum.accumulate(np.abs(found["force_n"]))[:-1]
    due_tick = np.flatnonzero(work_j > 0.5e-3 * most_n)[0]
    assert tripped - due_tick <= 3
    assert not found["force_n"][tripped + 20 :].any()
    assert abs(found["position_m"][tripped]) < 0.001


def test_a_push_ends_after_20_s():
    params = unverified()
    push = followed(Push(), 0.0, 0.1, 1000, params)
    assert not push_ended(push, 21_000, params)
    assert push_ended(push, 21_001, params) == FAULT


def test_work_done_with_the_force_does_not_pay_for_work_against_it():
    params = unverified()
    push = followed(Push(), 0.0, 0.8, 0, params)
    push = followed(push, 0.005, 0.8, 1, params)
    assert not push_ended(push, 1, params)
    push = followed(push, 0.0044, 0.8, 2, params)
    assert push_ended(push, 2, params) == FAULT


def test_a_verified_device_is_not_watched():
    found = pushed(servo_params(), FAR, lower_stop_m=-0.5, ticks=1200)
    assert abs(found["position_m"]).max() > 0.02
    assert not found["fault"].any()
    assert not (found["watches"] & COMMISSIONING).any()


def test_records_say_that_signs_are_not_verified():
    assert (pushed(unverified(), {}, ticks=10)["watches"] & COMMISSIONING).all()


def test_a_push_begins_anew_with_each_enable_and_is_in_the_checkpoint():
    flight = Flight(unverified())
    flight.do(Command.SET, {**FAR, Value.RAMP_S: 0.0})
    flight.do(Command.ENABLE)
    flight.fly(600)
    push = flight.state[0].plan.push
    assert push.start_tick > 0
    assert unflatten(flatten(flight.state))[0].plan.push == push
    flight.do(Command.DISABLE)
    assert flight.state[0].plan.push == Push()
    assert flight.state[0].plan.state is State.DISABLED


def test_a_push_is_watched_after_its_ramp_too():
    """The handle goes 10 mm with the force at 0.1 m/s, long after the gain's ramp."""
    flight = Flight(unverified())
    flight.do(Command.SET, {**FAR, Value.RAMP_S: 0.0})
    flight.do(Command.ENABLE)
    flight.fly(1000)
    for _ in range(110):
        flight.encoder -= round(1e-4 / COUNT_M)
        flight.fly(1)
    assert flight.state[0].plan.fault == FAULT
