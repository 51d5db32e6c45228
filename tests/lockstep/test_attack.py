"""The attack of `make bench`: it commands, strikes and judges as it says, on a few flights."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from support.boards import board_params
from support.models import servo_params

from benchmarks.attack import KINDS, RARE, TRAITS
from benchmarks.attack_watch import DTYPE, Given, Watch
from hapticd.mailbox.layout import Command, Result, Value, values_of
from hapticd.model.params import HandParams, TouchParams
from hapticd.run.lockstep import LockStep
from hapticd.sim.injection import IN_FAULTS, OUT_FAULTS

SPRING = {Value.STIFFNESS: 200.0, Value.VIRTUAL_DAMPING: 2.0, Value.RAMP_S: 0.0}
BOARD = board_params(touch=TouchParams(hands=(HandParams("push", force_n=1.0),)), watchdog_ms=20.0)


def test_every_fault_of_the_simulated_board_is_tried() -> None:
    assert set(KINDS) == {*OUT_FAULTS, *IN_FAULTS}
    assert set(RARE) <= set(TRAITS)


class Rigged:
    """A servo under force whose motor the judge watches, for a board that does what it must not."""

    def __init__(self, stack: LockStep) -> None:
        self.stack = stack
        self.watch = Watch(stack, servo_params(), BOARD)
        stack.run(5)
        stack.do(Command.SET, SPRING)
        self.enabled_at = stack.do(Command.ENABLE).first_tick
        stack.run(700)
        self.axis = stack.backend._port._axis  # type: ignore[attr-defined]

    def rules(self) -> set[str]:
        """What the judge found."""
        none = (0.0,) * 20
        self.watch.given.append(Given(Command.ENABLE, Result.APPLIED, self.enabled_at, none))
        self.watch.given.append(Given(Command.SET, Result.APPLIED, 5, values_of(SPRING)))
        records = np.frombuffer(b"".join(self.stack.blocks), DTYPE)
        lies = np.zeros((2, len(records)), bool)
        return {one.rule for one in self.watch.judge(records, lies)}


@pytest.fixture
def rigged() -> Iterator[Rigged]:
    with LockStep(servo_params(), BOARD) as stack:
        yield Rigged(stack)


def test_judge_finds_nothing_where_nothing_is(rigged: Rigged) -> None:
    rigged.stack.run(200)
    assert rigged.rules() == set()


def test_judge_sees_force_without_authority(rigged: Rigged) -> None:
    rigged.axis.live = False
    rigged.axis.run_to(rigged.axis.now + 4)
    assert "authority" in rigged.rules()


@pytest.mark.parametrize(("factor", "rule"), [(20.0, "clamp"), (-2.0, "step")])
def test_judge_sees_what_the_motor_does_and_not_what_was_sent(
    rigged: Rigged, factor: float, rule: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = type(rigged.axis)._command

    def wrong(axis: Any, force_n: float, seq: int) -> None:
        command(axis, factor * force_n, seq)

    monkeypatch.setattr(type(rigged.axis), "_command", wrong)
    rigged.stack.run(20)
    assert rule in rigged.rules()


def test_judge_sees_force_that_outlives_a_stop(
    rigged: Rigged, monkeypatch: pytest.MonkeyPatch
) -> None:
    rigged.stack.do(Command.STOP)
    obey = type(rigged.axis).obey

    def held(axis: Any, flags: int, torque: int, *rest: Any) -> None:
        obey(axis, 1, 4000, *rest)

    monkeypatch.setattr(type(rigged.axis), "obey", held)
    rigged.stack.run(60)
    assert "end" in rigged.rules()


def test_judge_sees_a_watchdog_that_does_not_bite(rigged: Rigged) -> None:
    """An alarm that is set anew for ever."""
    axis = rigged.axis
    assert axis.force_n
    for _ in range(60):
        axis._alarm_at = axis.now + 32
        axis.run_to(axis.now + 16)
    assert "silence" in rigged.rules()
