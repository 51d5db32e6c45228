"""One bad sample of the encoder moves nothing in a homing: neither its push nor what it finds."""

import numpy as np
import pytest
from support.boards import board_params
from support.homing_rig import HOME
from support.models import COUNT_M, device_params, servo_params

from hapticd.core.faults import BY_CODE
from hapticd.core.params import InjectionParams, TouchParams
from hapticd.mailbox.layout import Command, Result
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.safety import State

STOP_M = -0.004
TOUCH = TouchParams(stop_stiffness_n_per_m=1e5, stop_damping_ns_per_m=5.0)
TICKS = 3000
SEEN_N = 0.05  # of 0.5 N: what a sample that waits for the next one leaves


def homed(*injections):
    """Records of a homing, and the origin that it found."""
    device = device_params(home=HOME, acceleration_limit_m_per_s2=500.0)
    board = board_params(touch=TOUCH, lower_stop_m=STOP_M, injections=injections)
    with LockStep(servo_params(device=device), board) as stack:
        stack.run(5)
        assert stack.do(Command.HOME).result is Result.APPLIED
        return as_records(stack.run(TICKS)), stack.loop.state[0].plan.origin


@pytest.fixture(scope="module")
def undisturbed():
    ticks, origin = homed()
    assert ticks["homed"][-1]
    return ticks, origin


@pytest.mark.parametrize("glitch_m", [4e-3, -1.2e-2])
@pytest.mark.parametrize("tick", [40, 300, 560, 700, 1000, 1500, 2300, 2700])
def test_one_bad_sample_changes_neither_push_nor_origin(undisturbed, tick, glitch_m):
    jump = InjectionParams("encoder_jump", tick=tick, value=glitch_m / COUNT_M)
    ticks, origin = homed(jump)
    usual, found = undisturbed
    assert ticks["homed"][-1]
    assert not ticks["fault"].any()
    assert abs(origin - found) <= 4
    both = (ticks["state"] == State.HOMING) & (usual["state"] == State.HOMING)
    assert np.abs(ticks["force_n"] - usual["force_n"])[both].max() < SEEN_N


def test_an_encoder_that_keeps_lying_ends_homing():
    burst = InjectionParams("encoder_burst", tick=300, count=100, value=8000)
    ticks, _ = homed(burst)
    assert ticks["fault"][-1] == BY_CODE["sensor_glitch"].number
    assert not ticks["homed"][-1]


def test_homing_goes_on_though_every_other_frame_is_lost():
    """Every sample then comes behind a lost one."""
    lost = (InjectionParams("drop_in", tick=tick) for tick in range(41, 2600, 2))
    ticks, _ = homed(*lost)
    assert ticks["homed"][-1]
