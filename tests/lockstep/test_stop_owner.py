"""A stop is its presser's for 1 s: nobody else resets it meanwhile, nor by pressing it too."""

from collections.abc import Iterator

import pytest
from support.boards import board_params
from support.models import servo_params

from hapticd.mailbox import files
from hapticd.mailbox.daemons import press_stop
from hapticd.mailbox.layout import Command, Result, Value
from hapticd.run.lockstep import LockStep

A, B, STOP_PAGE = 16, 17, 2
FADE_TICKS = 21  # after which the word is taken back


@pytest.fixture
def stack() -> Iterator[LockStep]:
    with LockStep(servo_params(), board_params()) as stack:
        stack.run(5)
        yield stack


def asked(stack: LockStep, kind: Command, actor: int) -> tuple[Result, int, int, int]:
    """Result, tick, until which tick it is barred, and whose the stop is."""
    seq = stack.command(kind, actor=actor)
    stack.run(1)
    (found,) = [one for one in stack.gateway.answers() if one.seq == seq]
    owner = int(found.effective[Value.STOP_OWNER])
    return found.result, found.first_tick, found.ramp_end_tick, owner


def test_a_stop_is_not_reset_by_another_client_for_1_s(stack: LockStep) -> None:
    _, pressed, _, _ = asked(stack, Command.STOP, A)
    refused = asked(stack, Command.RESET, B)
    assert refused == (Result.REFUSED_OWNER, pressed + 1, pressed + 1000, A)
    stack.run(pressed + 999 - stack.loop.tick)
    assert asked(stack, Command.RESET, B)[:2] == (Result.REFUSED_OWNER, pressed + 999)
    assert asked(stack, Command.RESET, B)[:2] == (Result.APPLIED, pressed + 1000)


def test_who_pressed_may_reset_at_once(stack: LockStep) -> None:
    asked(stack, Command.STOP, A)
    assert asked(stack, Command.RESET, A)[0] is Result.APPLIED
    assert asked(stack, Command.RESET, B)[0] is Result.APPLIED  # nothing is stopped any more


def test_pressing_too_takes_no_stop_over(stack: LockStep) -> None:
    """Neither the first presser nor the second may undo what the other wanted."""
    asked(stack, Command.STOP, A)
    _, pressed, _, _ = asked(stack, Command.STOP, B)
    for actor in (A, B):
        result, _, until, owner = asked(stack, Command.RESET, actor)
        assert (result, until, owner) == (Result.REFUSED_OWNER, pressed + 1000, 0)
    stack.run(1000)
    assert asked(stack, Command.RESET, B)[0] is Result.APPLIED


def test_the_stop_page_is_an_actor_of_its_own(stack: LockStep) -> None:
    press_stop(stack.gateway.folder)
    stack.run(1)
    result, _, _, owner = asked(stack, Command.RESET, A)
    assert (result, owner) == (Result.REFUSED_OWNER, STOP_PAGE)
    stack.run(1000)
    assert asked(stack, Command.RESET, A)[0] is Result.APPLIED


def test_a_press_of_the_stop_page_in_a_clients_name_is_that_clients(stack: LockStep) -> None:
    press_stop(stack.gateway.folder, A)
    asked(stack, Command.STOP, A)  # by the gateway as well: one client, two ways
    stack.run(FADE_TICKS)
    result, _, _, owner = asked(stack, Command.RESET, B)
    assert (result, owner) == (Result.REFUSED_OWNER, A)
    assert asked(stack, Command.RESET, A)[0] is Result.APPLIED


@pytest.mark.parametrize("ticks_between", [0, 1])
def test_two_who_press_the_stop_page_may_both_not_reset_it(
    stack: LockStep, ticks_between: int
) -> None:
    press_stop(stack.gateway.folder, A)
    stack.run(ticks_between)
    press_stop(stack.gateway.folder, B)
    stack.run(FADE_TICKS + 1)
    for actor in (A, B):
        assert asked(stack, Command.RESET, actor)[0] is Result.REFUSED_OWNER


@pytest.mark.parametrize("number", [0, 1, STOP_PAGE, 15, 1 << 32, (1 << 64) - 1])
def test_a_press_that_names_no_client_is_the_stop_pages(stack: LockStep, number: int) -> None:
    word = stack.gateway.folder / files.STOP
    word.write_bytes(number.to_bytes(8, "little") if number else b"")
    stack.run(1)
    result, _, _, owner = asked(stack, Command.RESET, A)
    assert (result, owner) == (Result.REFUSED_OWNER, STOP_PAGE)


def test_a_stop_that_is_held_down_stays(stack: LockStep) -> None:
    asked(stack, Command.STOP, A)
    for _ in range(30):
        stack.run(100)
        asked(stack, Command.STOP, A)
        assert asked(stack, Command.RESET, B)[0] is Result.REFUSED_OWNER


def test_a_stop_in_a_fault_has_an_owner_too(stack: LockStep) -> None:
    asked(stack, Command.ENABLE, A)
    stack.run(100)
    stack.gateway_alive = False
    stack.run(1100)
    stack.gateway_alive = True
    stack.run(5)
    assert stack.loop.state[0].plan.state.name == "FAULT"
    asked(stack, Command.STOP, A)
    assert asked(stack, Command.RESET, B)[0] is Result.REFUSED_OWNER
    assert asked(stack, Command.RESET, A)[0] is Result.APPLIED
