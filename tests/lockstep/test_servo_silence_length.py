"""A silence lasts what was asked, to the tick: the board sees it by its own clock."""

import numpy as np
import pytest
from support.boards import board_params
from support.models import servo_params

from hapticd.core.params import RealtimeParams, UsbParams
from hapticd.mailbox.layout import Command, Flag, Result, Value
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep

pytestmark = pytest.mark.usefixtures("either_way")


PERIODS = [1, 2, 7, 8, 9, 10, 25, 64, 300, 500]


def flown(periods, rate_hz=1000.0, timeout_ms=1):
    """When the board took an OUT frame [s], from the command on, and the records."""
    servo = servo_params(
        realtime=RealtimeParams(mode="off", rate_hz=rate_hz), usb=UsbParams(timeout_ms=timeout_ms)
    )
    with LockStep(servo, board_params(watchdog_ms=20.0, rate_hz=rate_hz)) as stack:
        stack.run(10)
        stack.blocks.clear()
        deliver = stack.backend.deliver
        taken_ns = []

        def noted(data, t_ns):
            taken_ns.append(t_ns)
            deliver(data, t_ns)

        stack.backend.deliver = noted
        stack.run(2)
        answer = stack.do(Command.WITHHOLD, {Value.SILENCE_S: periods / rate_hz})
        assert answer.result is Result.APPLIED
        stack.run(periods + 40)
        return np.array(taken_ns) * 1e-9, as_records(b"".join(stack.blocks))


@pytest.mark.parametrize("periods", PERIODS)
@pytest.mark.parametrize("rate_hz", [1000.0, 500.0])
def test_a_silence_lasts_what_was_asked_to_the_tick(periods, rate_hz):
    taken_s, ticks = flown(periods, rate_hz)
    assert np.diff(taken_s).max() * rate_hz == pytest.approx(periods + 1, abs=0.01)
    quiet = np.flatnonzero(ticks["flags"] & Flag.WITHHELD)
    lasted = int(ticks["slot"][quiet[-1] + 1]) - int(ticks["slot"][quiet[0]])
    assert lasted == periods


def test_a_slow_bus_does_not_lengthen_a_silence_by_more_than_its_last_read():
    """Each read in vain takes three periods; the last ones are left out for that."""
    taken_s, _ = flown(100, timeout_ms=3)
    assert np.diff(taken_s).max() == pytest.approx(0.101, abs=0.0021)
