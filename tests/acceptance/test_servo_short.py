"""Force that is withheld again and again, and never becomes whole in between, is given up."""

import numpy as np
import pytest
from support.boards import board_params
from support.models import servo_params

from hapticd.core.faults import BY_CODE
from hapticd.core.params import SafetyParams
from hapticd.mailbox.layout import Command, Result, Value
from hapticd.model.params import InjectionParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.safety import State

BEGIN = 700


def struck(kind, period, ticks, count=1, value=0.0):
    """`kind` strikes every `period` ticks, from BEGIN on, for so many ticks."""
    starts = range(BEGIN, BEGIN + ticks, period)
    return tuple(InjectionParams(kind, tick=tick, count=count, value=value) for tick in starts)


def flown(injections, ticks, ramp_s=0.5):
    """Records of an enabled flight from the first strike on."""
    servo = servo_params(safety=SafetyParams(enable_ramp_s=ramp_s))
    with LockStep(servo, board_params(injections=injections)) as stack:
        stack.run(5)
        stack.do(Command.SET, {Value.STIFFNESS: 100.0, Value.RAMP_S: 0.0})
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        stack.run(BEGIN - stack.loop.tick)
        return as_records(stack.run(ticks))


CASES = [
    ("drop_in", 3, 2, 0.0, 0.5, "frames_lost"),  # two of three
    ("drop_in", 3, 2, 0.0, 0.02, "frames_lost"),
    ("drop_in", 200, 6, 0.0, 0.5, "frames_lost"),  # a silence five times a second
    ("emergency_stop", 300, 1, 0.004, 0.5, "no_authority"),
]


@pytest.mark.parametrize(("kind", "period", "count", "value", "ramp_s", "code"), CASES)
def test_force_that_never_becomes_whole_is_given_up(kind, period, count, value, ramp_s, code):
    ticks = flown(struck(kind, period, 2400, count, value), 2400, ramp_s)
    since = int(np.flatnonzero(ticks["gain"] < 1.0)[0])
    fault = int(np.flatnonzero(ticks["state"] == State.FAULT)[0])
    limit = 1000 * ramp_s + 1000
    assert limit < fault - since <= limit + period + 3
    assert ticks["fault"][-1] == BY_CODE[code].number
    assert ticks["gain"][since:fault].max() < 1.0


def test_force_that_is_whole_in_between_goes_on():
    """A silence every 0.7 s, for seven seconds."""
    ticks = flown(struck("drop_in", 700, 7000, 6), 7000)
    assert set(ticks["state"]) == {State.ENABLED}
    assert ticks["gain"].min() == 0.0
    assert ticks["gain"][-100] == 1.0
