"""A slow processor on virtual time: which rates it holds, and what the servo says of it."""

from test_servo_slow_processor import room, ticked


def test_slow_processor_is_warned_of_where_less_than_a_quarter_is_left() -> None:
    assert not room(ticked(4000.0, 8.0), 4000.0).short
    assert room(ticked(8000.0, 6.0), 8000.0).short
