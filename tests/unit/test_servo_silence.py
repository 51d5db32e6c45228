"""Frames are withheld only while nothing acts, for a bounded time, and whatever happens ends it."""

import pytest
from support.boards import board_params
from support.models import servo_params

from hapticd.core.params import UsbParams
from hapticd.mailbox.layout import Command, Flag, Result, State, Value
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import SETTLED, flatten, unflatten
from hapticd.usb.frames import StatusBit

SILENCE = {Value.SILENCE_S: 0.05}


@pytest.fixture
def stack():
    with LockStep(servo_params(), board_params(watchdog_ms=20.0)) as found:
        found.run(10)
        yield found


def silent(records):
    return (records["flags"] & Flag.WITHHELD) != 0


@pytest.mark.parametrize("seconds", [0.0, 1.5, float("nan")])
def test_a_silence_has_a_length_within_a_second(stack, seconds):
    answer = stack.do(Command.WITHHOLD, {Value.SILENCE_S: seconds})
    assert answer.result is Result.REFUSED_RANGE
    assert not silent(as_records(stack.run(100))).any()


def test_a_silence_without_a_length_is_refused(stack):
    assert stack.do(Command.WITHHOLD).result is Result.REFUSED_RANGE


def test_only_a_disabled_servo_withholds_frames(stack):
    stack.do(Command.ENABLE)
    assert stack.do(Command.WITHHOLD, SILENCE).result is Result.REFUSED_STATE
    stack.do(Command.STOP)
    assert stack.do(Command.WITHHOLD, SILENCE).result is Result.REFUSED_STATE
    assert not silent(as_records(stack.run(100))).any()


def test_two_silences_do_not_add_up(stack):
    assert stack.do(Command.WITHHOLD, SILENCE).result is Result.APPLIED
    assert stack.do(Command.WITHHOLD, SILENCE).result is Result.REFUSED_STATE
    assert silent(as_records(stack.run(100))).sum() < 50


def test_the_board_takes_frames_as_ever_afterwards(stack):
    stack.do(Command.WITHHOLD, SILENCE)
    records = as_records(stack.run(200))
    assert records["state"].max() == State.DISABLED
    assert (records["status"] & StatusBit.WATCHDOG).astype(bool).sum() == 1
    assert records["arrival"][-100:].max() == 0
    assert not records["force_n"].any()
    assert stack.do(Command.ENABLE).result is Result.APPLIED
    assert as_records(stack.run(100))["state"][-1] == State.ENABLED


@pytest.mark.parametrize("kind", [Command.STOP, Command.HOME, Command.ENABLE])
def test_what_ends_the_state_ends_the_silence(stack, kind):
    stack.do(Command.WITHHOLD, {Value.SILENCE_S: 1.0})
    answer = stack.do(kind)
    records = as_records(stack.run(100))
    if answer.result is Result.APPLIED:
        assert not silent(records).any()
    else:
        assert records["state"].max() == State.DISABLED
        assert not records["force_n"].any()


def test_an_enable_is_refused_once_frames_are_overdue(stack):
    stack.do(Command.WITHHOLD, {Value.SILENCE_S: 1.0})
    stack.run(20)
    assert stack.do(Command.ENABLE).result is Result.REFUSED_CAUSE


def test_a_cable_that_is_pulled_in_a_silence_is_noticed(stack):
    stack.do(Command.WITHHOLD, {Value.SILENCE_S: 1.0})
    stack.backend.unplug()
    records = as_records(stack.run(50))
    assert records["state"][-1] == State.FAULT
    assert not silent(records[-30:]).any()


def test_a_board_that_has_not_tripped_gets_no_force_with_its_authority(stack):
    """A silence of 5 ms: the frame behind it has ENABLE, and the count of no force."""
    stack.do(Command.WITHHOLD, {Value.SILENCE_S: 0.005})
    records = as_records(stack.run(20))
    granted = (records["status"] & StatusBit.ENABLED) != 0
    assert granted.sum() <= 1
    assert not records["force_n"].any()
    assert abs(records["position_m"]).max() == 0.0


def test_slots_that_it_listened_in_vain_are_not_lost_ones():
    """Each read of a bus with a time-out of 3 ms takes three slots."""
    slow = servo_params(usb=UsbParams(timeout_ms=3))
    with LockStep(slow, board_params(watchdog_ms=20.0)) as stack:
        stack.run(10)
        before = stack.gateway.counters()
        stack.do(Command.WITHHOLD, {Value.SILENCE_S: 0.3})
        records = as_records(stack.run(500))
        after = stack.gateway.counters()
    assert records["slot"][-1] - records["tick"][-1] > 30
    assert after["lost_slots"] == before["lost_slots"]
    assert after["grace_lost_slots"] == before["grace_lost_slots"]
    tripped = (records["status"] & StatusBit.WATCHDOG) != 0
    assert tripped.sum() == 1


def test_a_replay_from_a_checkpoint_goes_on_with_the_silence(stack):
    stack.do(Command.WITHHOLD, SILENCE)
    stack.run(5)
    state = stack.loop.state
    assert state[SETTLED].plan.silent_until > stack.loop.slot
    again = unflatten(flatten(state))
    assert again[SETTLED].plan.silent_until == state[SETTLED].plan.silent_until
    assert again[SETTLED].out_flags == state[SETTLED].out_flags
