"""Whatever a command's mask is, the servo answers and lives on."""

from math import inf, nan

import pytest
from support.boards import board_params
from support.models import servo_params
from support.proxies import with_range

from hapticd.mailbox import layout
from hapticd.mailbox.layout import Command, Result, Value
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.safety import State

NO_MASKS = (nan, inf, -inf, -1.0, 1e300, float(1 << layout.COMMAND_VALUES))
OBEYED = (Command.STOP, Command.DISABLE, Command.RESET, Command.ZERO, Command.PERTURB_STOP)


def said(stack, kind, first):
    """What becomes of a command of which every number is `first`."""
    seq = stack.gateway.post(kind, 1, 0, (first,) * layout.COMMAND_VALUES)
    stack.run(2)
    return next(one.result for one in stack.gateway.answers() if one.seq == seq)


@pytest.mark.parametrize("mask", NO_MASKS)
@pytest.mark.parametrize("enabled", [False, True])
def test_no_mask_ends_the_servo(mask, enabled):
    with LockStep(servo_params(), board_params()) as stack:
        stack.run(5)
        for kind in (one for one in Command if one not in OBEYED):
            if enabled:
                stack.do(Command.ENABLE)
            result = said(stack, kind, mask)
            refused = (Result.REFUSED_RANGE, Result.REFUSED_STATE, Result.CANCELLED)
            assert result in refused, kind
            assert stack.loop.state[0].plan.state is (State.ENABLED if enabled else State.DISABLED)
        assert said(stack, Command.STOP, mask) is Result.APPLIED
        assert as_records(stack.run(5))["state"][-1] == State.STOPPED


@pytest.mark.parametrize("number", NO_MASKS)
def test_no_number_of_a_proxy_ends_the_servo_or_is_answered(number):
    with LockStep(with_range(), board_params()) as stack:
        stack.run(5)
        stack.do(Command.SET, {Value.LEASE_CONTROL: 1.0})
        stack.do(Command.ENABLE)
        values = layout.values_of({Value.PROXY: number})
        seq = stack.gateway.post(Command.PROXY, 1, 0, values)
        record = as_records(stack.run(5))[-1]
        assert seq not in [one.seq for one in stack.gateway.answers()]
        assert record["state"] == State.ENABLED
        assert record["proxy_m"] == record["force_n"] == 0.0
