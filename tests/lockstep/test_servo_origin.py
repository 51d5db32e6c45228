"""An origin that was made, or used, and then lost is asked for again: nothing pulls to a place that
nobody chose.
"""

import numpy as np
import pytest
from support.boards import board_params
from support.homing_rig import HOME, Rig
from support.models import servo_params

from hapticd.mailbox.layout import Command, Result, Value
from hapticd.model.params import HandParams, InjectionParams, TouchParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.safety import State

AWAY = TouchParams(hands=(HandParams("push", 0.01, 0.1, 0.05),))
SPRING = {Value.STIFFNESS: 200.0, Value.RAMP_S: 0.0}
LOSSES = [
    ("io_error", 0.0),
    ("unplug", 0.2),
    ("restart", 0.0),
    ("encoder_jump", 1_000_000),
    ("encoder_fault", 0.05),
]


def lost_at(tick, kind, value):
    return board_params(touch=AWAY, injections=(InjectionParams(kind, tick=tick, value=value),))


@pytest.mark.parametrize(("kind", "value"), LOSSES)
def test_zero_that_was_lost_is_asked_for_again(kind, value):
    """Zeroed some 10 mm away from where the board was powered up."""
    with LockStep(servo_params(), lost_at(600, kind, value)) as stack:
        away = as_records(stack.run(400))["position_m"][-1]
        assert away > 0.008
        assert stack.do(Command.ZERO).result is Result.APPLIED
        assert stack.do(Command.SET, SPRING).result is Result.APPLIED
        stack.do(Command.ENABLE)
        lost = as_records(stack.run(1500))
        assert lost["state"][-1] == State.FAULT
        assert lost["homed"][-1] == 0
        assert stack.do(Command.RESET).result is Result.APPLIED
        stack.run(50)
        assert stack.do(Command.ENABLE).result is Result.REFUSED_NOT_HOMED
        assert not as_records(stack.run(100))["force_n"].any()
        assert stack.do(Command.ZERO).result is Result.APPLIED
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        again = as_records(stack.run(600))
    assert again["state"][-1] == State.ENABLED
    assert np.abs(again["force_n"]).max() < 0.01


@pytest.mark.parametrize(("kind", "value"), LOSSES)
def test_origin_of_the_power_up_that_was_used_is_asked_for_again(kind, value):
    with LockStep(servo_params(), lost_at(800, kind, value)) as stack:
        stack.run(5)
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        stack.run(2000)
        assert stack.do(Command.RESET).result is Result.APPLIED
        stack.run(50)
        assert stack.do(Command.ENABLE).result is Result.REFUSED_NOT_HOMED
        assert stack.do(Command.ZERO).result is Result.APPLIED
        assert stack.do(Command.ENABLE).result is Result.APPLIED


@pytest.mark.parametrize("kind", ["io_error", "unplug"])
def test_origin_that_nobody_used_may_come_anew(kind):
    """A device that is plugged in again before it was ever enabled starts as one that starts."""
    with LockStep(servo_params(), lost_at(300, kind, 0.2)) as stack:
        assert as_records(stack.run(1500))["state"][-1] == State.FAULT
        assert stack.do(Command.RESET).result is Result.APPLIED
        stack.run(50)
        assert stack.do(Command.ENABLE).result is Result.APPLIED


def test_loss_while_disabled_is_remembered():
    with LockStep(servo_params(), lost_at(1000, "restart", 0.0)) as stack:
        stack.run(5)
        stack.do(Command.ENABLE)
        stack.run(300)
        stack.do(Command.DISABLE)
        assert as_records(stack.run(1500))["state"][-1] == State.DISABLED
        assert stack.do(Command.ENABLE).result is Result.REFUSED_NOT_HOMED


def test_homing_that_failed_leaves_no_origin_to_enable_at():
    """Whoever asked for an origin did not trust the one there was."""
    rig = Rig(HOME, granted=lambda tick: tick < 300)
    rig.fly()
    rig.fly(Command.ZERO)
    rig.fly(Command.HOME)
    while rig.plan.state is State.HOMING:
        rig.fly()
    assert not rig.plan.homed
    rig.granted = lambda tick: True
    for _ in range(30):
        rig.fly()
    rig.fly(Command.RESET)
    assert rig.fly(Command.ENABLE)[-1][0][1] == Result.REFUSED_NOT_HOMED


def test_homing_makes_a_lost_origin_good():
    rig = Rig(HOME, lower_stop_m=-0.004)
    rig.fly()
    rig.fly(Command.ENABLE)
    rig.fly(Command.DISABLE)
    assert rig.home(-0.004).homed
    assert rig.fly(Command.ENABLE)[-1][0][1] == Result.APPLIED
