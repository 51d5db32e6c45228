"""The number of the terms by which a change was judged, as the servo compares it at the tick."""

from collections.abc import Iterator

import pytest
from support.boards import board_params
from support.models import servo_params

from hapticd.mailbox.layout import ANY_TERMS, Command, Result, Value, values_of
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import in_slots

OURS = 7.0
OTHERS = 6.0


@pytest.fixture
def stack() -> Iterator[LockStep]:
    with LockStep(servo_params(), board_params()) as stack:
        stack.run(5)
        yield stack


def terms(stack: LockStep, number: float = OURS) -> None:
    assert stack.do(Command.TERMS, {Value.TERMS: number}).result is Result.APPLIED


def changed(number: float | None, stiffness: float = 50.0) -> dict[Value, float]:
    named = {} if number is None else {Value.TERMS: number}
    return {Value.STIFFNESS: stiffness, Value.RAMP_S: 0.0} | named


def stiffness(stack: LockStep, ticks: int) -> float:
    return float(as_records(stack.run(ticks))["stiffness_n_per_m"][-1])


@pytest.mark.parametrize("kind", [Command.SET, Command.ENABLE])
def test_what_was_judged_by_other_terms_is_refused(stack: LockStep, kind: Command) -> None:
    terms(stack)
    assert stack.do(kind, {Value.TERMS: OTHERS}).result is Result.REFUSED_TERMS
    assert stack.do(kind, {Value.TERMS: OURS}).result is Result.APPLIED


@pytest.mark.parametrize("number", [None, OTHERS])
def test_what_was_scheduled_by_other_terms_is_cancelled(
    stack: LockStep, number: float | None
) -> None:
    assert stack.do(Command.SET, changed(number), 100).result is Result.SCHEDULED
    terms(stack)
    assert stiffness(stack, 200) == 0.0


def test_what_was_scheduled_by_these_terms_comes_into_force(stack: LockStep) -> None:
    terms(stack)
    stack.do(Command.SET, changed(OURS), 100)
    terms(stack)
    assert stiffness(stack, 200) == 50.0


def test_end_of_a_bounded_change_is_cancelled_by_a_stop_alone(stack: LockStep) -> None:
    stack.do(Command.SET, changed(None))
    stack.do(Command.SET, changed(float(ANY_TERMS), 10.0), 100)
    terms(stack)
    stack.do(Command.CANCEL, {Value.STIFFNESS: 0.0})
    assert stiffness(stack, 200) == 10.0
    stack.do(Command.SET, changed(float(ANY_TERMS), 20.0), 400)
    stack.do(Command.STOP)
    assert stiffness(stack, 400) == 10.0


@pytest.mark.parametrize("values", [{}, {Value.TERMS: -1.0}, {Value.TERMS: float("nan")}])
def test_terms_without_a_number_are_refused(stack: LockStep, values: dict[Value, float]) -> None:
    assert stack.do(Command.TERMS, values).result is Result.REFUSED_RANGE


@pytest.mark.parametrize("mask", [float("nan"), float("inf"), -1.0, 2.0**60])
def test_a_mask_that_is_none_ends_no_servo_that_has_lost_slots(mask: float) -> None:
    """Ticks become slots before the command is looked at."""
    values = (mask, *values_of({Value.UNTIL_TICK: 90.0})[1:])
    requests = ((1, int(Command.SET), 16, 80, values), (2, 100, 0, 0, (5.0,)))
    shifted = in_slots(requests, 3)
    assert [one[3] for one in shifted] == [83, 0]
    assert shifted[0][4] is values
    assert shifted[1] == requests[1]


def test_both_ticks_of_a_bounded_change_become_slots() -> None:
    values = values_of({Value.STIFFNESS: 5.0, Value.UNTIL_TICK: 90.0})
    ((_, _, _, begin, after),) = in_slots(((1, int(Command.SET), 16, 80, values),), 3)
    assert (begin, after[Value.UNTIL_TICK], after[Value.STIFFNESS]) == (83, 93.0, 5.0)
