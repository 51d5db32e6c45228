"""An example asks the guard again while it has no verdict, and accepts nothing but a verdict."""

import sys

import pytest
from support.examples import EXAMPLES

from hapticd.core.errors import CommandError
from hapticd.protocol.answers import GuardVerdict


@pytest.fixture
def connect(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.delitem(sys.modules, "connect", raising=False)
    import connect

    monkeypatch.setattr(connect, "PAUSE_S", 0.0)
    return connect


class Device:
    """Answers `set` by a guard with the given verdicts, one after the other."""

    def __init__(self, *verdicts):
        self.verdicts = list(verdicts)

    def set(self, **settings):
        verdict = self.verdicts.pop(0)
        if verdict != "applied":
            raise CommandError("guard", "refused", guard=verdict)


def verdict(safe):
    return GuardVerdict(safe=safe)


def test_a_busy_guard_is_asked_again(connect):
    device = Device(verdict(None), verdict(None), "applied")
    assert connect.permitted(device, K=100.0)
    assert not device.verdicts


def test_an_unsafe_setting_is_not_permitted(connect):
    assert not connect.permitted(Device(verdict(None), verdict(False)), K=100.0)


def test_another_refusal_is_no_verdict(connect):
    with pytest.raises(CommandError):
        connect.permitted(Device(None), K=100.0)


def test_a_guard_without_a_verdict_is_no_answer(connect, monkeypatch):
    monkeypatch.setattr(connect, "PATIENCE_S", 0.0)
    with pytest.raises(CommandError):
        connect.permitted(Device(*[verdict(None)] * 3), K=100.0)
