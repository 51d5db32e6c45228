"""A board that has started anew makes no force before it has said who it is, however often the
question fails, and nobody is asked while force acts.
"""

import errno
import json

import numpy as np
import pytest
from support.boards import board_params
from support.models import device_params, servo_params

from hapticd.core.faults import BY_CODE
from hapticd.core.units import NS_PER_MS
from hapticd.mailbox import files
from hapticd.mailbox.layout import Command, Result, Value
from hapticd.model.params import InjectionParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import DEVICE_DIFFERS
from hapticd.servo.safety import State
from hapticd.sim.bus import usb_error
from hapticd.usb.device import SEED
from hapticd.usb.frames import OutFlag, Request

RESTART = InjectionParams("restart", tick=50)
SEEN = device_params(signs_firmware="1.0")


class Requests:
    """The control requests of `stack`'s board from now on: the first `failing` of that `kind` end
    with `number`, a time-out after 100 ms; the others take `slow_ms`.
    """

    def __init__(self, stack, kind, failing=0, number=errno.EPIPE, slow_ms=0):
        self.stack, self.kind, self.failing, self.number = stack, kind, failing, number
        self.slow_ms = slow_ms
        self.under_force = 0
        self.asked = 0
        self._transfer = stack.backend.ctrl_transfer
        stack.backend.ctrl_transfer = self.transfer

    def transfer(self, handle, request_type, request, *others):
        flags = self.stack.loop.state[0].out_flags
        self.under_force += bool(flags & OutFlag.ENABLE)
        if request == self.kind.value:
            self.asked += 1
            self.pass_time(self.slow_ms)
            if self.asked <= self.failing:
                self.pass_time(100 if self.number == errno.ETIMEDOUT else 0)
                raise usb_error(self.number)
        return self._transfer(handle, request_type, request, *others)

    def pass_time(self, time_ms):
        clock = self.stack.clock
        clock.sleep_until_ns(clock.now_ns() + time_ms * NS_PER_MS)


def flashed(stack):
    """From its next start on the board says firmware 1.7."""
    replies = stack.backend._port.board._replies
    greeting = (0xC0, 1, 0)
    replies[greeting] = replies[greeting][:8] + b"\x07" + replies[greeting][9:]


def said(stack):
    return json.loads((stack.mailbox.folder / files.REPORT).read_text())["differences"]


def enabled_after_reset(stack):
    stack.do(Command.RESET)
    stack.do(Command.ZERO)
    return stack.do(Command.ENABLE).result


@pytest.mark.parametrize("number", [errno.EPIPE, errno.ETIMEDOUT])
def test_a_flashed_board_is_looked_at_though_its_first_hello_fails(number):
    servo = servo_params(device=SEEN, simulated=False)
    with LockStep(servo, board_params(injections=(RESTART,))) as stack:
        stack.run(30)
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        flashed(stack)
        requests = Requests(stack, Request.HELLO, failing=2, number=number)
        stack.run(30)
        assert enabled_after_reset(stack) is Result.REFUSED_DEVICE
        stack.run(3000)
        assert requests.asked == 3
        assert enabled_after_reset(stack) is Result.REFUSED_DEVICE
        assert said(stack)[0].startswith("firmware: the board has 1.7")
        assert stack.loop.state[0].plan.fault == 0


def test_no_force_comes_before_the_board_has_said_who_it_is():
    """Its hello fails for ever: it was not looked at, whatever it would say."""
    with LockStep(servo_params(device=SEEN), board_params(injections=(RESTART,))) as stack:
        stack.run(30)
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        Requests(stack, Request.HELLO, failing=10**6)
        for _ in range(10):
            stack.run(100)
            assert enabled_after_reset(stack) is Result.REFUSED_DEVICE
        assert "cannot request HELLO" in said(stack)[0]
        ticks = as_records(b"".join(stack.blocks))
    after = ticks[int(np.flatnonzero(ticks["arrival"] == SEED)[-1]) :]
    assert 50 <= after["tick"][0] < 53
    assert (after["host"] & DEVICE_DIFFERS).all()
    assert State.ENABLED not in set(after["state"])


def test_a_board_whose_hello_failed_once_may_make_force_after_the_next():
    with LockStep(servo_params(device=SEEN), board_params(injections=(RESTART,))) as stack:
        stack.run(30)
        Requests(stack, Request.HELLO, failing=1)
        stack.run(300)
        assert enabled_after_reset(stack) is Result.APPLIED
        assert set(as_records(stack.run(300))["state"]) == {State.ENABLED}


def test_a_phase_that_was_not_set_is_no_look():
    """The board of a slow bus has forgotten its phase, and does not take it again."""
    far = board_params(
        out_transport_us=160.0,
        in_transport_us=240.0,
        injections=(InjectionParams("restart", tick=200),),
    )
    with LockStep(servo_params(), far) as stack:
        stack.run(100)
        Requests(stack, Request.SAMPLE_PHASE, failing=10**6)
        stack.run(400)
        assert enabled_after_reset(stack) is Result.REFUSED_DEVICE


def test_a_board_that_is_found_to_differ_under_force_is_a_fault():
    with LockStep(servo_params(), board_params()) as stack:
        stack.run(5)
        stack.do(Command.SET, {Value.STIFFNESS: 100.0})
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        stack.run(600)
        stack.loop.connection.check = stack.loop.connection.check.barred("somebody said so")
        ticks = as_records(stack.run(600))
        assert ticks["state"][-1] == State.FAULT
        assert ticks["fault"][-1] == BY_CODE["device_differs"].number
        assert ticks["force_n"][-1] == 0.0


@pytest.mark.parametrize("kind", [Request.HELLO, Request.SAMPLE_PHASE])
def test_nobody_is_asked_while_force_acts_however_slow_the_board_answers(kind):
    """The board starts anew, is reset and enabled as soon as it may be; every request takes 90 ms.
    No tick with force is longer than a period.
    """
    far = board_params(
        out_transport_us=120.0,
        in_transport_us=180.0,
        injections=tuple(InjectionParams("restart", tick=tick) for tick in (900, 1700)),
    )
    with LockStep(servo_params(simulated=False), far) as stack:
        stack.run(5)
        stack.do(Command.SET, {Value.STIFFNESS: 100.0})
        stack.do(Command.ENABLE)
        requests = Requests(stack, kind, slow_ms=90)
        for _ in range(400):
            stack.command(Command.RESET)
            stack.command(Command.ZERO)
            stack.command(Command.ENABLE)
            stack.run(5)
            list(stack.gateway.answers())
        ticks = as_records(b"".join(stack.blocks))
        assert requests.asked == 2
        assert requests.under_force == 0
        assert stack.device.counts["lives"] == 2
    live = ticks["state"] == State.ENABLED
    both = live[1:] & live[:-1]
    assert both[-100:].all()
    assert (ticks["time_ns"][1:] - ticks["time_ns"][:-1])[both].max() < 2 * NS_PER_MS
