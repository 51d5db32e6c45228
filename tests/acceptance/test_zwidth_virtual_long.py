"""The virtual board answers as a daemon does: limits, leases, the guard, sequences, asyncio."""

from collections.abc import Iterator

import numpy as np
import pytest

import hapticd
from hapticd.client import CommandError, step
from hapticd.run.virtual import VirtualBoard

pytestmark = pytest.mark.filterwarnings("ignore::hapticd.core.errors.GuardWarning")


@pytest.fixture
def board() -> Iterator[VirtualBoard]:
    with hapticd.virtual_board() as board:
        yield board


def tick(board: VirtualBoard) -> int:
    return int(board.newest["tick"])


def test_a_silent_client_loses_its_lease_and_one_that_sleeps_in_it_does_not(
    board: VirtualBoard,
) -> None:
    with board.lease("environment", ttl_s=2.0) as lease:
        lease.sleep(10.0)
        board.set(K=10)
    with pytest.raises(CommandError, match="lease"), board.lease("environment", ttl_s=2.0):  # noqa: PT012
        board.sleep(10.0)
        board.set(K=20)


def test_the_hand_moves_the_handle(board: VirtualBoard) -> None:
    assert board.record(0.5)[0]["position_m"].std() == 0.0
    with hapticd.virtual_board(hand=True) as held:
        assert 2e-4 < held.record(2.0)[0]["position_m"].std() < 2e-3


def test_two_boards_repeat_each_other_to_the_bit() -> None:
    records = []
    for _ in range(2):
        with hapticd.virtual_board(hand=True) as board:
            board.damping("on")
            board.enable()
            board.set(K=100)
            records.append(board.record(0.5)[0])
    for name in ("position_m", "force_n", "tick", "revision"):
        assert np.array_equal(*(one[name] for one in records))


def test_a_sequence_acts_at_its_ticks(board: VirtualBoard) -> None:
    steps = [
        step("damping", value="on"),
        step("enable", after_s=0.5),
        step("set", K=100, after_s=0.5),
        step("damping", value="off", after_s=1.0),
        step("disable", after_s=1.0),
    ]
    done = board.sequence(steps)
    assert all(one.acted for one in done)
    ticks = [one.tick for one in done]
    assert np.diff(ticks)[1:3].tolist() == [500, 1000]
    assert len({one.revision for one in done}) == len(done)
