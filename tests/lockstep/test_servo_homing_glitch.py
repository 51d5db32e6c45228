"""One bad sample of the encoder moves nothing in a homing: neither its push nor what it finds."""

from support.boards import board_params
from support.homing_rig import HOME
from support.models import device_params, servo_params

from hapticd.core.faults import BY_CODE
from hapticd.mailbox.layout import Command, Result
from hapticd.model.params import InjectionParams, TouchParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep

STOP_M = -0.004
TOUCH = TouchParams(stop_stiffness_n_per_m=1e5, stop_damping_ns_per_m=5.0)
TICKS = 3000


def homed(*injections):
    """Records of a homing, and the origin that it found."""
    device = device_params(home=HOME, acceleration_limit_m_per_s2=500.0)
    board = board_params(touch=TOUCH, lower_stop_m=STOP_M, injections=injections)
    with LockStep(servo_params(device=device), board) as stack:
        stack.run(5)
        assert stack.do(Command.HOME).result is Result.APPLIED
        return as_records(stack.run(TICKS)), stack.loop.state[0].plan.origin


def test_an_encoder_that_keeps_lying_ends_homing():
    burst = InjectionParams("encoder_burst", tick=300, count=100, value=8000)
    ticks, _ = homed(burst)
    assert ticks["fault"][-1] == BY_CODE["sensor_glitch"].number
    assert not ticks["homed"][-1]
