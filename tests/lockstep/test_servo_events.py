"""Events at the board's pins, from the pins to the record of a tick."""

import numpy as np
import pytest
from support.boards import board_params
from support.models import servo_params

from hapticd.core.params import UsbParams
from hapticd.model.params import InjectionParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import LINK_UP
from hapticd.usb.device import NO_CODE, NO_TIME_US
from hapticd.usb.frames import EVENT_DEPTH

MS_NS = 1_000_000
BOTH = [UsbParams(), UsbParams(in_flight=True)]
IN_TURN, IN_FLIGHT = BOTH
# a frame of either direction that is lost, damaged, late, twice or behind another one
LOSSES = (
    *("drop_in", "corrupt_in", "short_in", "babble", "delay_in", "duplicate_in", "stall_in"),
    *("zero_length_in", "drop_out", "corrupt_out", "stall_out", "late"),
)


def code_at(tick, code):
    return InjectionParams("event_code", tick=tick, value=code)


def flown(ticks=400, usb=IN_TURN, changes=(), **board):
    """Records of a flight; `changes` are (ns after its 100th tick, code at the pins)."""
    with LockStep(servo_params(usb=usb), board_params(**board)) as stack:
        stack.run(100)
        start_ns = stack.clock.now_ns()
        port = stack.backend._port
        for after_ns, code in changes:
            while stack.clock.now_ns() + MS_NS <= start_ns + after_ns:
                stack.run(1)
            port.set_event_code(start_ns + after_ns, code)
        stack.run(ticks)
        return as_records(b"".join(stack.blocks))


def events(records):
    """(code, time [us]) of each event."""
    there = records[records["event_code"] != NO_CODE]
    return list(zip(there["event_code"].tolist(), there["event_us"].tolist(), strict=True))


@pytest.mark.parametrize("usb", BOTH)
def test_an_event_has_its_code_and_its_own_time(usb):
    changes = ((250_000, 17), (5_625_000, 0), (41_000_000, 65535))
    records = flown(usb=usb, changes=changes)
    found = events(records)
    assert [code for code, _ in found] == [17, 0, 65535]
    times_us = np.array([time_us for _, time_us in found])
    assert np.diff(times_us).tolist() == [5375, 35375]
    rows = np.flatnonzero(records["event_code"] != NO_CODE)
    latest_us = records["board_us"][rows] - times_us  # before the sample that brought it
    assert ((latest_us >= 0) & (latest_us < 1000)).all()
    assert (records["event_us"][records["event_code"] == NO_CODE] == NO_TIME_US).all()
    assert records["events_lost"][-1] == 0


def test_a_code_that_is_held_counts_once():
    held = [InjectionParams("event_code", tick=50, count=1000, value=9)]
    assert [code for code, _ in events(flown(1500, injections=tuple(held)))] == [9]


@pytest.mark.parametrize("usb", BOTH)
@pytest.mark.parametrize("kind", LOSSES)
def test_no_event_is_lost_with_one_frame(kind, usb):
    """Two events, one tick after the other, at each place around it."""
    for tick in range(196, 202):
        fault = InjectionParams(kind, tick=200, value=0.0015 if kind == "delay_in" else 0.0)
        codes = (code_at(tick, 5), code_at(tick + 1, 6), code_at(250, 0))
        records = flown(300, usb, injections=(*codes, fault))
        if kind == "drop_out" and tick in (199, 200):
            continue  # nothing happens at the pins at an OUT that never was
        assert [code for code, _ in events(records)] == [5, 6, 0], (kind, tick)
        (_, first_us), _, (_, last_us) = events(records)
        # the OUT after a lost frame comes later in its period, and the change of the code with it
        assert last_us - first_us == pytest.approx(1000 * (250 - tick), abs=1000)
        assert records["events_lost"][-1] == 0


@pytest.mark.parametrize("many", [10, EVENT_DEPTH - 1, EVENT_DEPTH, 40])
def test_codes_that_change_faster_than_frames_wait_or_are_counted(many):
    """Changes 10 us apart, within one period: those that the board holds come in their order, each
    with its time; of more the oldest are lost.
    """
    changes = tuple((100_000 + 10_000 * place, 1 + place) for place in range(many))
    records = flown(changes=changes)
    found = events(records)
    lost = int(records["events_lost"][-1])
    assert len(found) + lost == many
    assert lost == max(0, many - EVENT_DEPTH)
    assert [code for code, _ in found] == list(range(1 + lost, 1 + many))
    assert np.ptp(np.diff([time_us for _, time_us in found])) <= 63  # of a sub-step


@pytest.mark.parametrize("count", [2, 20])
def test_a_board_without_event_pins_has_no_events(count):
    changes = tuple((MS_NS * place, 1 + place % 2) for place in range(count))
    records = flown(changes=changes, lacks=("event",))
    assert events(records) == []
    assert records["events_lost"][-1] == 0


def test_event_fields_of_a_board_without_the_capability_are_ignored():
    with LockStep(servo_params(), board_params()) as stack:
        stack.device.events.able = False
        stack.run(100)
        stack.backend._port.set_event_code(stack.clock.now_ns() + 100_000, 3)
        stack.run(100)
        records = as_records(b"".join(stack.blocks))
    assert events(records) == []


def test_what_was_at_the_pins_before_the_link_is_no_event():
    """Neither a code that is there, nor changes while no host was there to see them."""
    restarted = InjectionParams("restart", tick=300)
    records = flown(500, injections=(code_at(50, 6), restarted))
    assert [code for code, _ in events(records)] == [6]
    with LockStep(servo_params(), board_params(watchdog_ms=20.0)) as stack:
        stack.run(50)
        port = stack.backend._port
        start_ns = stack.clock.now_ns()
        for place in range(10):
            stack.clock.sleep_until_ns(start_ns + (place + 1) * 10 * MS_NS)
            port.set_event_code(stack.clock.now_ns(), 1 + place)
        stack.loop.restart_clock()
        stack.run(200)
        records = as_records(b"".join(stack.blocks))
    (code, time_us), *others = events(records)
    assert (code, others) == (10, [])
    assert records["events_lost"][-1] == 9
    assert time_us == NO_TIME_US or time_us < records["board_us"][-1]


def test_an_event_while_the_link_is_lost_is_recorded_if_the_board_lives_on():
    codes = (code_at(150, 2), code_at(200, 5))
    records = flown(300, injections=(*codes, InjectionParams("io_error", tick=200)))
    assert (records["host"] & LINK_UP == 0).any()
    assert [code for code, _ in events(records)] == [2, 5]
    assert records["events_lost"][-1] == 0


@pytest.mark.parametrize("fault", [("unplug", 1, 0.05), ("drop_out", 8, 0.0)])
def test_a_tick_without_a_frame_is_no_event_however_the_loop_was_entered(fault):
    kind, count, value = fault
    gone = InjectionParams(kind, tick=200, count=count, value=value)
    with LockStep(servo_params(), board_params(injections=(code_at(100, 5), gone))) as stack:
        for _ in range(400):
            stack.run(1)
        records = as_records(b"".join(stack.blocks))
    assert [code for code, _ in events(records)] == [5]
    assert records["events_lost"][-1] == 0


def test_times_are_right_where_board_time_wraps():
    """The clock wraps 150 ticks into the flight; board time in the record does not."""
    params = {"board_time_us": 2**32 - 150_000}
    changes = tuple((MS_NS * (40 + place), 1 + place) for place in range(0, 30, 3))
    found = events(flown(changes=changes, **params))
    times_us = np.array([time_us for _, time_us in found])
    assert set(np.diff(times_us)) == {3000}


def test_numbers_of_events_wrap():
    codes = tuple(code_at(tick, 1 + tick % 7) for tick in range(20, 920, 3))
    found = events(flown(1000, injections=codes))
    assert [code for code, _ in found] == [1 + tick % 7 for tick in range(20, 920, 3)]


def test_an_event_of_long_ago_has_no_time():
    """No frame came for longer than an age can say."""
    lost = InjectionParams("drop_in", tick=200, count=80)
    records = flown(400, injections=(code_at(200, 4), lost))
    assert events(records) == [(4, NO_TIME_US)]
