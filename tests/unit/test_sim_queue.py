"""A board whose endpoint queues IN frames instead of replacing them."""

import pytest
from support.boards import ENABLE, LATCH_NS, TICK_NS, board_params, out_packet

from hapticd.model.params import BoardParams
from hapticd.sim.board import BoardModel, QueueingBoard, make_board
from hapticd.usb import codec
from hapticd.usb.frames import InFrame

DEPTHS = [1, 2, 3, 4]


def unread(depth: int, ticks: int) -> BoardModel:
    """A board that was sent `ticks` OUT frames and asked for nothing."""
    board = make_board(board_params(in_queue_depth=depth))
    for tick in range(ticks):
        board.on_out(out_packet(tick, flags=ENABLE), tick * TICK_NS)
    return board


def drained(board: BoardModel, t_ns: int) -> list[InFrame]:
    """All that a host gets that reads until there is no more."""
    packets = iter(lambda: board.poll_in(t_ns), None)
    return [codec.decode_in(packet) for packet in packets]


def test_board_without_the_trait_is_the_plain_one() -> None:
    assert type(make_board(board_params())) is BoardModel
    assert type(make_board(board_params(in_queue_depth=1))) is QueueingBoard


@pytest.mark.parametrize("depth", DEPTHS)
def test_oldest_frames_wait_and_the_newest_is_replaced(depth: int) -> None:
    board = unread(depth, 9)
    frames = drained(board, 9 * TICK_NS)
    assert [frame.echo for frame in frames] == [*range(depth), 8]
    assert board.in_replaced == 9 - depth - 1


@pytest.mark.parametrize("depth", DEPTHS)
def test_a_pause_leaves_the_host_behind_for_ever(depth: int) -> None:
    """One read a tick never catches up: what a kind board hides."""
    board = unread(depth, 5)
    lag = []
    for tick in range(5, 30):
        packet = board.poll_in(tick * TICK_NS)
        assert packet is not None
        lag.append(tick - 1 - codec.decode_in(packet).echo)
        board.on_out(out_packet(tick, flags=ENABLE), tick * TICK_NS)
    assert lag[-1] == lag[-10] == depth


@pytest.mark.parametrize("depth", DEPTHS)
def test_host_that_reads_each_frame_sees_no_queue(depth: int) -> None:
    plain = make_board(board_params())
    queueing = make_board(board_params(in_queue_depth=depth))
    for tick in range(40):
        packets = []
        for board in (plain, queueing):
            board.on_out(out_packet(tick, flags=ENABLE, torque=3000), tick * TICK_NS)
            assert board.next_in_ns() == tick * TICK_NS + LATCH_NS
            packets.append(board.poll_in((tick + 1) * TICK_NS - 1))
        assert packets[0] == packets[1]


def test_pairs_of_queued_frames_are_neither_lost_nor_doubled() -> None:
    board = unread(3, 12)
    frames = drained(board, 12 * TICK_NS)
    for tick in range(12, 20):
        board.on_out(out_packet(tick, flags=ENABLE), tick * TICK_NS)
        frames += drained(board, (tick + 1) * TICK_NS - 1)
    indices = [frame.probe_index + place for frame in frames for place in range(len(frame.pairs))]
    assert indices == list(range(len(indices)))


def test_power_up_empties_the_queue() -> None:
    board = unread(4, 5)
    board.power_up()
    assert board.next_in_ns() is None
    assert board.poll_in(99 * TICK_NS) is None


def test_kind_board_is_the_default() -> None:
    fields = BoardParams.__dataclass_fields__
    names = ("in_queue_depth", "board_time_us", "out_transport_us", "in_transport_us", "bus")
    assert not any(fields[name].default for name in names)
