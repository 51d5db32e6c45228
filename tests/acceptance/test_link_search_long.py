"""A board that is not ready is waited for, and it is said what for: at the start, and when it comes
back to a servo that runs.
"""

from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from support.boards import board_params
from support.models import servo_params
from test_link_search import (
    BOOT,
    FOREIGN_HELLO,
    HASH,
    OWNER,
    REASON,
    RIGHTS,
    SLOW,
    START_NS,
    claimed,
    denied,
    slow,
)

from hapticd.mailbox import files
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.run.lockstep import LockStep
from hapticd.sim.backend import READY, SimulatedBackend, Unready


def dead(backend: SimulatedBackend) -> None:
    backend.unready = Unready(boot_loader_s=1e6)


def another_hash(backend: SimulatedBackend) -> None:
    backend.unready = Unready(boot_loader_s=1e6, boot_hello=FOREIGN_HELLO)


REFUSED = [(denied, RIGHTS), (slow, SLOW), (dead, BOOT), (another_hash, HASH), (claimed, OWNER)]


@pytest.mark.parametrize(("refuse", "said"), REFUSED)
def test_reconnect_that_is_refused_is_told_and_tried_again(
    refuse: Callable[[SimulatedBackend], None], said: str
) -> None:
    with LockStep(servo_params(), board_params()) as stack:
        told: list[str] = []
        stack.loop.connection.tell = told.append
        stack.run(100)
        refuse(stack.backend)
        stack.backend.unplug(away_s=0.2)
        # a servo that runs waits for a wrong hash longer than a start
        stack.run(31_000 if refuse is another_hash else 2000)
        waiting = stack.gateway.report()["waiting_for"]
        assert said in waiting
        assert told[-1] == waiting
        # at most: the dead device that is listed once more, nothing, what it is refused for
        assert len(told) <= 4
        assert all(before != after for before, after in pairwise(told))
        assert not stack.loop.connection.linked
        stack.backend.access_denied = stack.backend.kernel_driver = False
        stack.backend.unready = READY
        stack.backend.unplug(away_s=0.2)
        stack.run(3000)
        assert stack.loop.connection.linked
        assert told[-1] == stack.gateway.report()["waiting_for"] == ""
        assert stack.gateway.report()["reconnected"] == "SIM0001"
        assert stack.gateway.counters()["reconnects"] == 1


@pytest.fixture
def waiting(runtime: Path) -> Iterator[ServoMailbox]:
    """A servo that waits for its board; there is no gateway, or it has no servo yet."""
    mailbox = ServoMailbox(files.runtime_folder(), 1000.0, "", True, START_NS)
    mailbox.report({"waiting_for": REASON})
    yield mailbox
    mailbox.close()
