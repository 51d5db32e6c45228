"""Journal and checkpoints: what the servo leaves so that its flight can be flown again."""

import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from hapticd.mailbox import layout
from hapticd.mailbox.client_side import GatewayMailbox, Noted
from hapticd.mailbox.layout import Command
from hapticd.mailbox.servo_side import ServoMailbox

STATE = (1, 2.5, "00ff", (3, (4.0, True)))


@pytest.fixture
def ends(tmp_path: Path) -> Iterator[tuple[ServoMailbox, GatewayMailbox]]:
    servo = ServoMailbox(tmp_path / "run", 1000.0, "c" * 64, True, 1)
    servo.publish()
    gateway = GatewayMailbox(tmp_path / "run")
    yield servo, gateway
    gateway.close()
    servo.close()


def request(seq: int, *values: float) -> tuple[int, int, int, int, tuple[float, ...]]:
    return seq, int(Command.SET), 16, 0, values


def test_requests_are_noted_with_their_tick(ends: tuple[ServoMailbox, GatewayMailbox]) -> None:
    servo, gateway = ends
    servo.note(7, (request(1, 5.0, 6.0), request(2)))
    servo.note(9, (request(3, *range(layout.COMMAND_VALUES)),))
    found, tail, lost = gateway.journal(0)
    assert [(one.tick, one.seq, one.kind, one.actor) for one in found] == [
        (7, 1, 1, 16),
        (7, 2, 1, 16),
        (9, 3, 1, 16),
    ]
    assert found[0].values == (5.0, 6.0, *(0.0,) * (layout.COMMAND_VALUES - 2))
    assert (tail, lost) == (3, 0)
    assert gateway.journal(tail) == ([], 3, 0)


def test_overwritten_requests_are_counted(ends: tuple[ServoMailbox, GatewayMailbox]) -> None:
    servo, gateway = ends
    for number in range(layout.JOURNAL_SLOTS + 10):
        servo.note(number, (request(number),))
    found, tail, lost = gateway.journal(0)
    assert (len(found), lost, tail) == (layout.JOURNAL_SLOTS, 10, layout.JOURNAL_SLOTS + 10)
    assert found[0].seq == 10


def test_request_that_is_being_written_is_lost(ends: tuple[ServoMailbox, GatewayMailbox]) -> None:
    servo, gateway = ends
    servo.note(1, (request(1), request(2)))
    struct.pack_into("<Q", servo._map, layout.JOURNAL_OFFSET + layout.JOURNAL.size, 999)
    found, _, lost = gateway.journal(0)
    assert ([one.seq for one in found], lost) == ([1], 1)


def test_events_of_the_servo_keep_their_number(ends: tuple[ServoMailbox, GatewayMailbox]) -> None:
    servo, gateway = ends
    servo.note(3, ((0, 100, 0, 0, (9.0,)),))
    assert gateway.journal(0)[0] == [
        Noted(3, 0, 100, 0, 0, (9.0, *(0.0,) * (layout.COMMAND_VALUES - 1)))
    ]


def test_checkpoint_is_written_when_asked_for(ends: tuple[ServoMailbox, GatewayMailbox]) -> None:
    servo, gateway = ends
    assert (servo.checkpoint_due, gateway.checkpoint()) == (False, None)
    gateway.ask_checkpoint()
    assert servo.checkpoint_due
    servo.checkpoint(257, STATE)
    assert (servo.checkpoint_due, gateway.checkpoints) == (False, 1)
    assert gateway.checkpoint() == (257, STATE)


def test_newest_checkpoint_is_read(ends: tuple[ServoMailbox, GatewayMailbox]) -> None:
    servo, gateway = ends
    for tick in (10, 20, 30):
        servo.checkpoint(tick, (tick,))
    assert gateway.checkpoint() == (30, (30,))


def test_damaged_checkpoint_is_none(ends: tuple[ServoMailbox, GatewayMailbox]) -> None:
    servo, gateway = ends
    servo.checkpoint(10, STATE)
    servo._map[layout.CHECKPOINT_OFFSET + layout.CHECKPOINT.size] ^= 1
    assert gateway.checkpoint() is None


def test_checkpoint_too_long_for_its_slot_is_left_out(
    ends: tuple[ServoMailbox, GatewayMailbox],
) -> None:
    servo, gateway = ends
    servo.checkpoint(10, ("x" * layout.CHECKPOINT_SLOT,))
    assert (gateway.checkpoints, gateway.checkpoint()) == (0, None)
