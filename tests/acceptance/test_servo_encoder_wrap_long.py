"""A handle that is drawn over the wrap of its encoder's counter: whatever is lost or doubted there,
the flight is the one that another count would give.
"""

import numpy as np
import pytest
from support.boards import board_params
from support.models import COUNT_M, device_params, servo_params

from hapticd.mailbox.layout import Command, Result, Value
from hapticd.model.params import HandParams, InjectionParams, TouchParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.safety import State
from hapticd.usb import codec

DRAWN = TouchParams(hands=(HandParams("push", 0.6, 0.5, 0.3),))
WRAP = 1 << 31
AT = 700  # the tick of the wrap
SAME = ("position_m", "velocity_m_per_s", "force_n", "state", "fault", "gain", "flags")


def flown(first_count, *injections):
    """Records of a drawn handle whose encoder begins at that count."""
    servo = servo_params(device=device_params(acceleration_limit_m_per_s2=500.0))
    with LockStep(servo, board_params(touch=DRAWN, injections=injections)) as stack:
        port = stack.backend._port
        axis = getattr(port, "board", port)._axis
        axis.zero_m -= first_count * COUNT_M
        stack.run(5)
        assert stack.do(Command.ZERO).result is Result.APPLIED
        stack.do(
            Command.SET, {Value.STIFFNESS: 20.0, Value.VIRTUAL_DAMPING: 1.0, Value.RAMP_S: 0.0}
        )
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        stack.run(1000)
        return as_records(b"".join(stack.blocks))


def counts(flight):
    return np.array([codec.decode_in(bytes(one)).encoder for one in flight["in_frame"]])


@pytest.fixture(scope="module")
def before_wrap():
    """Where an encoder has to begin so that it wraps in tick AT."""
    ahead = counts(flown(0))
    assert ahead[AT] - ahead[AT - 1] > 2
    return WRAP - int(ahead[AT])


GLITCH = 8000
FAULTS = [
    (),
    *((InjectionParams("drop_in", tick=tick, count=count),) for tick in (AT - 1, AT)
      for count in (1, 2, 5)),
    (InjectionParams("drop_in", tick=AT - 4, count=12),),
    *((InjectionParams("encoder_jump", tick=tick, value=value),) for tick in (AT - 1, AT)
      for value in (GLITCH, -GLITCH)),
]  # fmt: skip


@pytest.mark.parametrize("injections", FAULTS)
def test_flight_is_the_same_over_the_wrap_of_the_encoder(before_wrap, injections):
    here = flown(0, *injections)
    there = flown(before_wrap, *injections)
    assert counts(there)[AT - 20] > 0 > counts(there)[AT + 20]
    for name in SAME:
        tolerance = {"position_m": COUNT_M, "velocity_m_per_s": 1e-3, "force_n": 1e-2}
        assert np.allclose(here[name][20:], there[name][20:], 0.0, tolerance.get(name, 0.0)), name
    lost = len(injections) and injections[0].count > 8
    assert (there["state"][-1] == State.ENABLED) == (not lost)
