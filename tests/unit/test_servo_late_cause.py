"""The cause of a late tick is the part that took longest beyond its usual time."""

import pytest

from hapticd.core.params import UsbParams
from hapticd.mailbox import layout
from hapticd.mailbox.layout import Flag, LateCause
from hapticd.servo import late as servo_late
from hapticd.servo.late import LateTicks, Ticked
from hapticd.usb.device import Device
from hapticd.usb.link import UsbLink

PERIOD_NS = 1_000_000
PUBLISH_NS = 5_000
USUAL = {"wake_ns": 100, "read_ns": 400_000, "step_ns": 10_000, "write_ns": 200_000}
LATCHED_US = 875  # from an OUT to the sample after it, on clocks with the same origin


def ticked(late: dict[str, int], out_late_us: int = 0) -> list[Ticked]:
    """Ticks on time, and a late one with the changes `late`, before which an OUT came late."""
    plain = Ticked(0, 0, 0, 0, 0, *USUAL.values(), 0, 0, 0)
    ready_us = sum(USUAL[f"{stage}_ns"] for stage in ("read", "step")) // 1000
    found = []
    for index in range(1, 5):
        board_us = 1000 * (index - 1) + ready_us + LATCHED_US
        found.append(plain._replace(woken_ns=index * PERIOD_NS, board_us=board_us))
    row = found[-1]
    more = {name: getattr(row, name) + extra for name, extra in late.items()}
    found[-1] = row._replace(board_us=row.board_us + out_late_us, **more)
    return found


def cause_of(ticks: list[Ticked], in_flight: bool, publish_ns: int = PUBLISH_NS) -> int:
    """Of the last of `ticks`."""
    wake_ns, read_ns, step_ns, write_ns = (
        getattr(ticks[-1], f"{stage}_ns") for stage in ("wake", "read", "step", "write")
    )
    parts = (wake_ns, read_ns, step_ns, write_ns, publish_ns)
    usual = (*USUAL.values(), PUBLISH_NS)
    return servo_late.cause_of(parts, usual, in_flight, lambda: ticks)


@pytest.mark.parametrize(
    ("late", "cause"),
    [
        ({"wake_ns": 500_000}, LateCause.WAKE),
        ({"step_ns": 500_000}, LateCause.STEP),
        ({"write_ns": 500_000}, LateCause.SUBMISSION),
        ({"read_ns": 500_000}, LateCause.COMPLETION),
        ({"read_ns": 200_000, "step_ns": 250_000}, LateCause.STEP),
        ({"wake_ns": 260_000, "step_ns": 250_000}, LateCause.WAKE),
    ],
)
def test_usual_time_of_a_part_does_not_count(late: dict[str, int], cause: LateCause) -> None:
    assert cause_of(ticked(late), True) == cause


def test_what_follows_the_frame_is_a_cause() -> None:
    assert cause_of(ticked({"wake_ns": 10_000}), True, PUBLISH_NS + 600_000) == LateCause.PUBLISH


@pytest.mark.parametrize("in_flight", [True, False])
@pytest.mark.parametrize(("held_up_us", "bus"), [(0, False), (100, False), (150, True)])
def test_read_is_late_by_the_bus_if_its_sample_was_latched_late(
    held_up_us: int, bus: bool, in_flight: bool
) -> None:
    ticks = ticked({"read_ns": 500_000}, out_late_us=held_up_us)
    otherwise = LateCause.COMPLETION if in_flight else LateCause.TRANSFER
    assert cause_of(ticks, in_flight) == (LateCause.BUS if bus else otherwise)


def test_part_of_a_write_that_waits_is_not_known() -> None:
    assert cause_of(ticked({"write_ns": 500_000}), False) == LateCause.TRANSFER


def test_sample_that_never_came_is_the_bus() -> None:
    ticks = ticked({"read_ns": 900_000})
    ticks[-1] = ticks[-1]._replace(arrival=-1)
    assert cause_of(ticks, True) == LateCause.BUS


def test_read_behind_an_out_that_is_stuck_is_the_bus() -> None:
    ticks = ticked({"read_ns": 900_000})
    ticks[-2] = ticks[-2]._replace(flags=Flag.WRITE_FAILED)
    assert cause_of(ticks, True) == LateCause.BUS
    ticks[-2] = ticks[-2]._replace(late_cause=LateCause.STEP)
    assert cause_of(ticks, True) == LateCause.STEP


def test_read_that_waits_because_the_tick_before_was_late_has_its_cause() -> None:
    ticks = ticked({"read_ns": 600_000})
    ticks[-1] = ticks[-1]._replace(late_cause=LateCause.WAKE)
    assert cause_of(ticks, True) == LateCause.WAKE


@pytest.mark.parametrize("in_flight", [True, False])
@pytest.mark.parametrize("part", ["read_ns", "write_ns", "wake_ns"])
def test_first_tick_may_be_late(part: str, in_flight: bool) -> None:
    assert cause_of(ticked({part: 900_000})[-1:], in_flight)


def test_ring_that_others_have_written_over_ends_no_servo() -> None:
    ring = memoryview(bytearray(b"\xff" * layout.TELEMETRY_BYTES))
    late = LateTicks(ring, PERIOD_NS, Device(UsbLink(UsbParams(), object()), 1000.0))
    late.learn(256)
    assert late.cause(100, 1 << 31)
    assert late.cause(0, 1 << 31)
