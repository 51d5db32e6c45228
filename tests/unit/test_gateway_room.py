"""The daemon warns where a tick leaves less than a quarter of its period."""

from dataclasses import asdict

import pytest

from hapticd.core.params import LEAST_IDLE_SHARE
from hapticd.gateway.tick_times import ENOUGH, room_of
from hapticd.mailbox.layout import STAGES
from hapticd.protocol.journal import sentence
from hapticd.run.doctor.late import judge_room


def stages(tick_us: float, count: int = ENOUGH) -> dict[str, dict[str, float]]:
    """A tick of `tick_us` in four equal stages, after a wake-up that counts for nothing."""
    found = {stage: {"count": count, "p50_us": 0.25 * tick_us} for stage in STAGES}
    return found | {"wake": {"count": count, "p50_us": 1e6}}


@pytest.mark.parametrize(
    ("tick_us", "rate_hz", "short", "highest_hz"),
    [(740.0, 1000.0, False, 1010.0), (760.0, 1000.0, True, 980.0), (100.0, 8000.0, True, 7500.0)],
)
def test_quarter_of_the_period_has_to_be_left(
    tick_us: float, rate_hz: float, short: bool, highest_hz: float
) -> None:
    room = room_of(stages(tick_us), rate_hz)
    assert (room.short, room.highest_rate_hz) == (short, highest_hz)
    assert not room_of(stages(tick_us), room.highest_rate_hz).short
    percent = 100.0 * room.tick_us / room.period_us
    text = sentence("tick_too_long", percent=percent, **asdict(room))
    assert f"a tick takes {tick_us:.0f} us" in text
    assert f"({percent:.0f} %, at most {100.0 * (1.0 - LEAST_IDLE_SHARE):.0f} % is safe)" in text
    assert f"realtime.rate_hz to {highest_hz:g} or less" in text
    check = judge_room(room)
    assert check.level == ("warn" if short else "ok")
    assert f"left up to {highest_hz:g} Hz" in check.found


def test_too_few_ticks_are_not_judged() -> None:
    room = room_of(stages(999.0, ENOUGH - 1), 1000.0)
    assert not room.short
    assert judge_room(room).found == "not measured yet"
    assert judge_room(None).level == "ok"
