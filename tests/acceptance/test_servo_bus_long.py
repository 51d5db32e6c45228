"""A bus whose measurement failed was not measured: no force before another one has succeeded."""

import pytest
from support.models import servo_params
from test_servo_bus import IN_TURN, failing, far_board

from hapticd.mailbox.layout import Command, Result
from hapticd.model.params import InjectionParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.safety import State
from hapticd.usb.frames import Request

EVER = range(10**6)


@pytest.mark.parametrize("kind", [Request.HELLO, Request.SAMPLE_PHASE])
def test_a_bus_that_is_never_measured_makes_no_force(monkeypatch, kind):
    failing(monkeypatch, kind, EVER[1:] if kind is Request.HELLO else EVER)
    with LockStep(servo_params(usb=IN_TURN), far_board(800.0)) as stack:
        for _ in range(8):
            stack.run(500)
            assert stack.do(Command.ENABLE).result is Result.REFUSED_DEVICE
        (reason,) = stack.loop.connection.check.report()["differences"]
    assert f"cannot request {kind.name}" in reason


def test_a_board_that_comes_back_is_measured_though_that_fails_at_first(monkeypatch):
    away = (InjectionParams("unplug", tick=200, value=0.05),)
    failing(monkeypatch, Request.SAMPLE_PHASE, range(1, 8))
    with LockStep(servo_params(usb=IN_TURN), far_board(400.0, injections=away)) as stack:
        stack.run(500)
        stack.do(Command.RESET)
        assert stack.do(Command.ENABLE).result is Result.REFUSED_DEVICE
        stack.run(6000)
        assert stack.do(Command.ENABLE).result is Result.APPLIED
        assert set(as_records(stack.run(500))["state"]) == {State.ENABLED}
