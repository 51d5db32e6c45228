"""Whoever may write the stop word may only stop: what he does to the file, the servo ends up
stopped, its process lives, and the word works again.
"""

import shutil
from collections.abc import Iterator

import pytest
from support.boards import board_params
from support.models import servo_params
from test_stop_word import ENABLE_TICKS, FIG_4, MENDED_TICKS, made_a_folder, states

from hapticd.mailbox import files
from hapticd.mailbox.layout import Command, Result, State
from hapticd.run.lockstep import LockStep

pytestmark = pytest.mark.usefixtures("either_way")


@pytest.fixture
def stack() -> Iterator[LockStep]:
    """A servo that renders."""
    with LockStep(servo_params(), board_params()) as found:
        found.run(5)
        assert found.do(Command.SET, FIG_4).result is Result.APPLIED
        assert found.do(Command.ENABLE).result is Result.APPLIED
        found.run(ENABLE_TICKS)
        yield found


def test_word_that_cannot_be_mended_stays_a_stop(stack: LockStep) -> None:
    made_a_folder(stack.mailbox.folder / files.STOP)
    for _ in range(5):
        assert states(stack, MENDED_TICKS + 1)[-1] == State.STOPPED
        assert stack.do(Command.RESET).result is Result.REFUSED_OWNER  # it is pressed all the time
    assert states(stack, MENDED_TICKS + 1)[-1] == State.STOPPED
    shutil.rmtree(stack.mailbox.folder / files.STOP)
