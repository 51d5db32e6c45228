"""Time is time, not ticks: ramps, holds and budgets end by the clock, and a silent link does not
stretch the ticks.
"""

from typing import Any

import numpy as np
import pytest
from support.boards import board_params
from support.models import device_params, servo_params
from support.recorded import RecordedFlight
from usb.core import USBTimeoutError

from hapticd.core.faults import BY_CODE
from hapticd.core.params import UsbParams
from hapticd.core.units import NS_PER_MS
from hapticd.mailbox.layout import Command, Result, Value
from hapticd.model.params import InjectionParams
from hapticd.protocol.view import as_records
from hapticd.recording import replay
from hapticd.run.lockstep import LockStep
from hapticd.servo.safety import State

pytestmark = pytest.mark.usefixtures("either_way")


PRESSED = {Value.STIFFNESS: 200.0, Value.RAMP_S: 0.0}
SILENT_AT = 1000
LATE_NS = 600_000  # what libusb takes longer than asked


def seconds_at(stack):
    return stack.clock.now_ns() * 1e-9


def pressed(stack):
    """Enabled, with some newtons at the motor of a handle that is hardly moved by them."""
    stack.run(5)
    stack.do(Command.SET, PRESSED)
    stack.do(Command.ENABLE)
    stack.load_waveform([32767] * 800)
    stack.do(Command.PERTURB_START, {Value.SAMPLES: 800.0, Value.LOOP: 0.0})
    stack.run(SILENT_AT - stack.loop.tick - 10)
    return stack.backend._port.board._axis


def slow_timeouts(stack):
    wait = stack.backend._wait

    def late(timeout_ms):
        try:
            return wait(timeout_ms)
        except USBTimeoutError:
            stack.clock.sleep_until_ns(stack.clock.now_ns() + LATE_NS)
            raise

    stack.backend._wait = late


@pytest.mark.parametrize(
    ("timeout_ms", "late"), [(1, False), (1, True), (2, False), (2, True), (5, False)]
)
def test_force_is_gone_in_time_though_no_frame_comes(timeout_ms, late):
    """At the simulated motor, by the board's clock: detected in 10 ms, gone 20 ms later; a read
    that waits may add its time-out to each.
    """
    silent = (InjectionParams("drop_in", tick=SILENT_AT, count=400),)
    params = servo_params(usb=UsbParams(timeout_ms=timeout_ms))
    with LockStep(params, board_params(mass_kg=1.0, injections=silent)) as stack:
        if late:
            slow_timeouts(stack)
        axis = pressed(stack)
        before = abs(axis.force_n)
        while stack.loop.tick < SILENT_AT + 200:
            began_s = seconds_at(stack)
            newest = as_records(stack.run(1))[-1]
            if newest["arrival"] == -1:
                lost_s = began_s
            if newest["state"] == State.FAULT:
                break
        assert newest["fault"] == BY_CODE["frames_lost"].number
        fault_s = seconds_at(stack)
        forces = []
        while axis.force_n and seconds_at(stack) - fault_s < 0.2:
            stack.run(1)
            forces.append(abs(axis.force_n))
        gone_s = seconds_at(stack)
    wait_s = timeout_ms * 1e-3 + (LATE_NS * 1e-9 if late else 0.0)
    assert before > 2.0
    assert fault_s - lost_s <= 0.010 + 2 * wait_s
    assert gone_s - fault_s <= 0.0201 + wait_s
    assert max(forces, default=0.0) <= before


@pytest.mark.parametrize("late", [False, True])
def test_a_silent_link_does_not_stretch_the_ticks(late):
    """OUT frames go on coming: no two in a row wait for a read."""
    silent = (InjectionParams("drop_in", tick=SILENT_AT, count=400),)
    with LockStep(servo_params(), board_params(mass_kg=1.0, injections=silent)) as stack:
        if late:
            slow_timeouts(stack)
        pressed(stack)
        stack.run(30)
        began_s = seconds_at(stack)
        sent = stack.backend._port.tick
        lengths_s = []
        for _ in range(100):
            last_s = seconds_at(stack)
            stack.run(1)
            lengths_s.append(seconds_at(stack) - last_s)
        sent = stack.backend._port.tick - sent
    assert sent == 100
    assert seconds_at(stack) - began_s <= (0.151 if late else 0.101)
    assert max(lengths_s) <= (0.0027 if late else 0.0021)


def test_one_lost_frame_costs_one_sample():
    single = (InjectionParams("drop_in", tick=SILENT_AT, count=1),)
    with LockStep(servo_params(), board_params(mass_kg=1.0, injections=single)) as stack:
        slow_timeouts(stack)
        pressed(stack)
        arrivals = as_records(stack.run(50))["arrival"].tolist()
    assert sum(arrival < 0 for arrival in arrivals) == 1


def slow_host(stack, pause_ms):
    """Every tick of the host starts `pause_ms` late."""
    wait = stack.loop.wait

    def paused(deadline_ns, rehearse):
        wait(deadline_ns, rehearse)
        stack.clock.sleep_until_ns(stack.clock.now_ns() + round(pause_ms * NS_PER_MS))
        return stack.clock.now_ns()

    stack.loop.wait = paused


def elapsed_s(stack, until, most_s=10.0):
    """Time until the newest record fulfils `until`."""
    began_s = seconds_at(stack)
    while not until(as_records(stack.run(1))[-1]):
        assert seconds_at(stack) - began_s < most_s
    return seconds_at(stack) - began_s


def test_commands_are_asked_for_and_answered_in_ticks_of_the_record():
    with LockStep(servo_params(), board_params(mass_kg=1.0)) as stack:
        stack.run(20)
        slow_host(stack, 3.7)
        stack.run(50)
        asked = stack.loop.tick + 40
        began_s = seconds_at(stack)
        values = {Value.STIFFNESS: 100.0, Value.RAMP_S: 0.0}
        seq = stack.command(Command.SET, values, at_tick=asked)
        flown = as_records(stack.run(60))
        answers = {answer.result: answer for answer in stack.gateway.answers()}
    scheduled = answers[Result.SCHEDULED]
    applied = answers[Result.APPLIED]
    assert scheduled.seq == applied.seq == seq
    assert scheduled.first_tick == asked
    acting = flown[flown["stiffness_n_per_m"] == 100.0]
    assert applied.first_tick == acting["tick"][0]
    # 40 periods later by the clock, as the slots say
    assert acting["slot"][0] - (asked + flown["slot"][0] - flown["tick"][0]) in range(6)
    assert acting["time_ns"][0] * 1e-9 - began_s == pytest.approx(0.04, abs=0.006)


def test_slots_count_what_the_clock_counts():
    with LockStep(servo_params(), board_params(mass_kg=1.0)) as stack:
        first = as_records(stack.run(30))
        stack.clock.time_ns += 40 * NS_PER_MS
        flown = as_records(stack.run(30))
    assert np.array_equal(first["slot"], first["tick"])
    lapsed = (flown["time_ns"] - first["time_ns"][0]) // NS_PER_MS
    assert np.array_equal(flown["slot"][1:], lapsed[1:])
    assert np.array_equal(np.diff(flown["tick"]), np.ones(29))


def test_a_flight_with_lost_slots_is_replayed_bit_by_bit():
    with RecordedFlight(servo_params(device=device_params(force_step_n=0.01))) as flight:
        flight.move()
        flight.fly(400)
        slow_host(flight.stack, 2.3)
        flight.stack.command(Command.SET, PRESSED, at_tick=flight.stack.loop.tick + 90)
        flight.fly(400)
        flight.stack.do(Command.STOP)
        flight.fly(200)
        requests: Any = flight.stack.gateway.journal(0)[0]
        checkpoint = flight.publisher.flight._checkpoints[0]
        records = flight.records
    records = records[records["tick"] >= checkpoint.tick]
    segment = replay.Segment(checkpoint.tick, checkpoint.state, records, requests)
    assert (records["slot"] - records["tick"]).max() > 500
    assert set(records["stiffness_n_per_m"].tolist()) > {50.0, 200.0}
    assert replay.difference(records, replay.replay(flight.params, segment)) is None


@pytest.mark.parametrize("pause_ms", [0.0, 1.4, 2.4])
def test_authority_may_be_missing_for_periods_not_ticks(pause_ms):
    """From the emergency stop to the fault, by the clock: 8 periods, and the ticks around them."""
    pressed_for = (InjectionParams("emergency_stop", tick=SILENT_AT, value=0.5),)
    with LockStep(servo_params(), board_params(mass_kg=1.0, injections=pressed_for)) as stack:
        pressed(stack)
        slow_host(stack, pause_ms)
        while stack.backend._port.tick < SILENT_AT:
            stack.run(1)
        until_s = elapsed_s(stack, lambda record: record["state"] == State.FAULT)
        fault = as_records(stack.run(1))[-1]["fault"]
    tick_s = 0.001 + 2 * pause_ms * 1e-3
    assert fault == BY_CODE["no_authority"].number
    assert until_s <= 0.009 + 2 * tick_s
