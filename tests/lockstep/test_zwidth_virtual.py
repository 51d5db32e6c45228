"""The virtual board answers as a daemon does: limits, leases, the guard, sequences, asyncio."""

import asyncio
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import hapticd
from hapticd.client import CommandError
from hapticd.client.design import Condition, Table
from hapticd.core.params import AtEnd
from hapticd.run.virtual import VirtualBoard

pytestmark = pytest.mark.filterwarnings("ignore::hapticd.core.errors.GuardWarning")


@pytest.fixture
def board() -> Iterator[VirtualBoard]:
    with hapticd.virtual_board() as board:
        yield board


def test_a_change_beyond_a_limit_is_refused_with_value_and_limit(board: VirtualBoard) -> None:
    with pytest.raises(CommandError) as caught:
        board.set(K=1e9)
    assert caught.value.code == "invalid"
    assert caught.value.detail[0]["value"] == 1e9
    assert caught.value.detail[0]["high"] < 1e9


def test_the_guard_judges_and_refuses_as_its_policy_says(board: VirtualBoard) -> None:
    receipt = board.set(K=200, B=1)
    assert receipt.guard is not None
    assert receipt.guard.safe is False
    board.guard("refuse")
    with pytest.raises(CommandError) as caught:
        board.set(K=400, B=1)
    assert caught.value.guard is not None
    assert caught.value.guard.safe is False
    assert board.get().parameters["K"] == 200


def test_a_strict_client_is_refused_what_is_not_passive() -> None:
    with hapticd.virtual_board(strict=True) as board, pytest.raises(CommandError):
        board.set(K=200, B=1)


@pytest.mark.parametrize(
    ("at_end", "state", "stiffness"), [("disable", "disabled", 10), ("zero", "enabled", 0)]
)
@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_an_error_in_a_lease_does_what_the_lease_says_at_its_end(
    board: VirtualBoard, error: type[BaseException], at_end: AtEnd, state: str, stiffness: float
) -> None:
    with pytest.raises(error), board.lease("environment", at_end=at_end):  # noqa: PT012
        board.set(K=10)
        board.enable()
        raise error
    board.sleep(1.0)
    assert board.status().state == state
    assert board.get().parameters["K"] == stiffness
    board.set(K=5)  # its holder knows of it, and goes on


def test_a_lease_that_is_released_leaves_the_force(board: VirtualBoard) -> None:
    with board.lease("environment", at_end="disable"):
        board.set(K=10)
        board.enable()
    board.sleep(1.0)
    assert board.status().state == "enabled"


def test_an_error_in_a_lease_of_asyncio_does_the_same(board: VirtualBoard) -> None:
    async def session() -> None:
        client = board.aio()
        async with client.lease("environment", at_end="disable"):
            await client.enable()
            raise ValueError

    with pytest.raises(ValueError):  # noqa: PT011
        asyncio.run(session())
    board.sleep(0.1)
    assert board.status().state == "disabled"


def test_a_condition_that_nobody_feels_is_no_row(board: VirtualBoard, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    soft = Condition("soft", {"K": 10.0})
    with pytest.raises(CommandError, match="stopped"), Table(path) as table:  # noqa: PT012
        board.enable()
        table.begin(board.set(**soft.settings), soft)
        board.stop()
        table.begin(board.set(**soft.settings), soft)
    assert len(path.read_text().splitlines()) == 2  # the header, and what was felt


def test_asyncio_has_the_same_board(board: VirtualBoard) -> None:
    async def experiment() -> tuple[float, int, int]:
        async with board.aio() as device:
            receipt = await device.set(K=50)
            samples = await device.perturb_load(np.zeros(10_000))
            records, _ = await device.record(0.25)
            return receipt.effective["K"], samples, len(records)

    assert asyncio.run(experiment()) == (50.0, 10_000, 250)


def test_stop_latches_until_it_is_reset(board: VirtualBoard) -> None:
    assert board.stop().state == "stopped"
    with pytest.raises(CommandError) as caught:
        board.enable()
    assert caught.value.code == "stopped"
    board.sleep(1.1)
    board.reset()
    assert board.status().state == "disabled"
