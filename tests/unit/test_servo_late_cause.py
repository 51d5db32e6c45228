"""The cause of a late tick is the part that took longest beyond its usual time."""

from collections.abc import Sequence

import pytest

from hapticd.link.device import Device
from hapticd.link.usb import UsbLink
from hapticd.mailbox import layout
from hapticd.mailbox.layout import Flag, LateCause
from hapticd.params import UsbParams
from hapticd.servo import late as servo_late
from hapticd.servo.late import LateTicks, Ticked, Way

PERIOD_NS = 1_000_000
IN_TURN, IN_FLIGHT = Way(False, False), Way(True, False)
BEFORE = 8  # ticks on time
USUAL = {"wake_ns": 100, "read_ns": 400_000, "step_ns": 10_000, "write_ns": 200_000}
LATCHED_US = 875  # from an OUT to the sample after it, on clocks with the same origin


def cause_of(ticks: Sequence[Ticked], way: Way, usual: Sequence[int] | None = None) -> int:
    """By the ticks before the late one, which is the last but one."""
    *before, late, after = ticks
    usual = usual or servo_late.parts_of(before[0], before[1])
    return servo_late.cause_of(late, after, usual, way, lambda: before[-servo_late.EARLIER :])


def ticked(
    late: dict[str, int], out_late_us: int = 0, after_late_us: int = 0, count: int = BEFORE
) -> Sequence[Ticked]:
    """Ticks on time, a late one with the changes `late`, and the one after it.

    The OUT before the late tick comes `out_late_us` late to the board, its own `after_late_us`.
    """
    plain = Ticked(0, 0, 0, 0, 0, *USUAL.values(), 5_000, 0, 0)
    ready_us = sum(USUAL[f"{stage}_ns"] for stage in ("read", "step")) // 1000
    found = []
    for index in range(count + 2):
        woken_ns = (index + 1) * PERIOD_NS
        board_us = woken_ns // 1000 - 1000 + ready_us + LATCHED_US
        found.append(plain._replace(woken_ns=woken_ns, board_us=board_us))
    published_ns = late.pop("publish_ns", 5_000)
    held_us = sum(late.get(f"{stage}_ns", 0) for stage in ("read", "step")) // 1000
    row = found[-2]
    more = {name: getattr(row, name) + extra for name, extra in late.items()}
    found[-2] = row._replace(**more, board_us=row.board_us + out_late_us)
    after_us = found[-1].board_us + held_us + after_late_us
    found[-1] = found[-1]._replace(board_us=after_us, published_ns=published_ns)
    return found


@pytest.mark.parametrize(
    ("late", "cause"),
    [
        ({"wake_ns": 500_000}, LateCause.WAKE),
        ({"step_ns": 500_000}, LateCause.STEP),
        ({"publish_ns": 500_000}, LateCause.PUBLISH),
        ({"write_ns": 500_000}, LateCause.SUBMISSION),
        ({"read_ns": 500_000}, LateCause.COMPLETION),
        ({"read_ns": 200_000, "step_ns": 250_000}, LateCause.STEP),
        ({"wake_ns": 260_000, "step_ns": 250_000}, LateCause.WAKE),
    ],
)
def test_usual_time_of_a_part_does_not_count(late: dict[str, int], cause: LateCause) -> None:
    assert cause_of(ticked(late), IN_FLIGHT) == cause


@pytest.mark.parametrize("way", [IN_FLIGHT, IN_TURN])
@pytest.mark.parametrize(("held_up_us", "bus"), [(0, False), (100, False), (150, True)])
def test_read_is_late_by_the_bus_if_its_sample_was_latched_late(
    held_up_us: int, bus: bool, way: Way
) -> None:
    ticks = ticked({"read_ns": 500_000}, out_late_us=held_up_us)
    otherwise = LateCause.COMPLETION if way.in_flight else LateCause.TRANSFER
    assert cause_of(ticks, way) == (LateCause.BUS if bus else otherwise)


@pytest.mark.parametrize(
    ("held_up_us", "cause"), [(0, LateCause.COMPLETION), (490, LateCause.TRANSFER)]
)
def test_write_ended_late_if_its_out_was_in_time_at_the_board(
    held_up_us: int, cause: LateCause
) -> None:
    ticks = ticked({"write_ns": 500_000}, after_late_us=held_up_us)
    assert cause_of(ticks, IN_TURN) == cause


def test_sample_that_never_came_is_the_bus_and_one_that_came_after_its_tick_is_not() -> None:
    ticks = [*ticked({"read_ns": 900_000})]
    ticks[-2] = ticks[-2]._replace(arrival=-1)
    assert cause_of(ticks, IN_FLIGHT) == LateCause.BUS
    assert cause_of(ticks, Way(True, True)) == LateCause.COMPLETION


def test_read_behind_an_out_that_is_stuck_is_the_bus() -> None:
    ticks = [*ticked({"read_ns": 900_000})]
    ticks[-3] = ticks[-3]._replace(flags=Flag.WRITE_FAILED)
    assert cause_of(ticks, IN_FLIGHT) == LateCause.BUS
    ticks[-3] = ticks[-3]._replace(late_cause=LateCause.STEP)
    assert cause_of(ticks, IN_FLIGHT) == LateCause.STEP


def test_read_that_waits_because_the_tick_before_was_late_has_its_cause() -> None:
    ticks = [*ticked({"read_ns": 600_000})]
    ticks[-2] = ticks[-2]._replace(late_cause=LateCause.WAKE)
    assert cause_of(ticks, IN_FLIGHT) == LateCause.WAKE


@pytest.mark.parametrize("way", [IN_FLIGHT, IN_TURN])
@pytest.mark.parametrize("part", ["read_ns", "write_ns", "wake_ns"])
def test_first_tick_may_be_late(part: str, way: Way) -> None:
    ticks = ticked({part: 900_000}, count=0)
    assert cause_of(ticks, way, (0,) * len(layout.STAGES))


def test_ring_that_others_have_written_over_ends_no_servo() -> None:
    ring = memoryview(bytearray(b"\xff" * layout.TELEMETRY_BYTES))
    late = LateTicks(ring, PERIOD_NS, Device(UsbLink(UsbParams(), object()), 1000.0))
    late.learn(256)
    late.begin()
    late.blame(100, 1 << 40)
    place = layout.TELEMETRY_OFFSET + 100 * layout.RECORD.size + layout.offset_of("late_ns")
    assert ring[place : place + 4] == b"\xff\xff\xff\x7f"
