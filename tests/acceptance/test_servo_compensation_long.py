"""The compensation of the winding's resistance follows it from below, whatever sensor, current and
board do. The winding itself is integrated here, by its differential equation alone.
"""

from dataclasses import replace
from random import Random

import numpy as np
import pytest
from support.servo_compensation import ABLE, COUNT_OHM, Warm, copper, params
from test_servo_compensation import BLIND

from benchmarks.thermal import DAMPING_NS_PER_M, RECORD, deviation_pct, device, flown
from hapticd.mailbox.layout import Command, Value
from hapticd.model.params import HandParams, InjectionParams, TouchParams
from hapticd.recording.replay import Segment, replay
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import (
    SETTLED,
    flatten,
)
from hapticd.usb import codec


def test_board_without_the_dac_gets_0_and_loses_what_theory_says():
    moments = list(flown(*device(("resistance",)), 6))
    for one in moments:
        gain = 1.0 / (1.0 + DAMPING_NS_PER_M * (copper(one.winding_c) - 1.5) / 1.65**2)
        assert one.active_damping_ns_per_m == pytest.approx(DAMPING_NS_PER_M * gain, rel=0.01)
    assert deviation_pct(moments) > 15.0
    with LockStep(*device(("resistance",))) as stack:
        ticks = np.frombuffer(stack.run(500), dtype=RECORD)
        assert "has no resistance DAC" in stack.loop.connection.check.report()["uncompensated"]
    assert set(ticks["resistance_count"]) == {0}
    assert {codec.decode_out(bytes(one)).resistance for one in ticks["out_frame"]} == {0}


@pytest.mark.parametrize("reads_c", [80.0, -20.0])
def test_sensor_that_breaks_in_flight_never_over_compensates_the_circuit(reads_c):
    """4 N heat the winding; from 3 s on the sensor stands still, then the winding cools down. The
    circuit's own ohm are looked at in the simulated board.
    """
    servo, board = device()
    level = servo.device.active_damping_limit_ns_per_m
    hand = HandParams("push", 0.5, 6.0, 4.0)
    with LockStep(servo, replace(board, touch=TouchParams(hands=(hand,)))) as stack:
        axis = stack.backend._port._axis
        honest = stack.backend._port._celsius
        stack.do(Command.SET, {Value.STIFFNESS: 600.0, Value.RAMP_S: 0.0})
        stack.do(Command.DAMPING, {Value.ACTIVE_DAMPING: level, Value.ACTIVE_DAMPING_ON: 1.0})
        stack.do(Command.ENABLE)
        gains = []
        for step in range(200):
            if step == 30:
                stack.backend._port._celsius = lambda _state: reads_c
            stack.run(100)
            residual_ohm = copper(honest(axis.state)) - axis.believed_ohm
            gains.append(level * residual_ohm / 1.65**2)
        assert stack.loop.state[SETTLED].plan.fault == 0
    assert honest(axis.state) < 45.0
    assert min(gains[:30]) > 0.0
    assert min(gains) > (-0.3 if reads_c == 80.0 else 0.0)


def test_a_day_of_heating_cycles_leaves_no_trace():
    """24 h of 2.4 A for 20 s and 40 s of rest: the last hour is as the second one."""
    warm = Warm(params())
    found = {}
    while warm.tick < 86_400_000:
        left = warm.look(2.4 if warm.tick % 60_000 < 20_000 else 0.0)
        hour = found.setdefault(warm.tick // 3_600_000, [9.9, 0.0, 0.0])
        hour[0] = min(hour[0], left)
        hour[1] = max(hour[1], left) if warm.tick > 60_000 else 0.0
        hour[2] = max(hour[2], warm.plan.winding.high_c)
    assert found[23] == pytest.approx(found[1], rel=0.02)
    assert warm.least > 0.02
    assert found[23][1] < 0.06
    assert max(hour[2] for hour in found.values()) <= 120.0


def test_delivered_damping_and_force_stay_within_two_percent_while_the_winding_heats():
    moments = list(flown(*device(), 6))
    assert moments[0].winding_c == pytest.approx(20.0, abs=0.1)
    assert moments[-1].winding_c > 80.0
    assert deviation_pct(moments) <= 2.0
    gain = 1.0 / (1.0 + DAMPING_NS_PER_M * 0.03 / 1.65**2)  # the tolerance stays at any temperature
    for one in moments:
        assert one.active_damping_ns_per_m == pytest.approx(DAMPING_NS_PER_M * gain, rel=0.01)
        assert one.torque_gain == pytest.approx(gain, rel=0.01)


@pytest.mark.parametrize("blind", [False, True])
def test_winding_is_never_compensated_further_than_it_has(blind):
    """200 windings anywhere inside what the device file calls possible, at random currents."""
    random = Random(5)
    host = BLIND if blind else ABLE
    for _ in range(200):
        scale = [random.uniform(0.9, 1.1), random.uniform(0.9, 1.1), random.uniform(15.0, 25.0)]
        warm = Warm(params(), 8.0 * scale[0], 10.0 * scale[1], scale[2])
        ampere = 0.0
        for step in range(300):
            if step % 60 == 0:
                ampere = random.choice((0.0, 1.0, 2.0, 3.0))
            warm.look(ampere, host=host)
        assert warm.least > (0.03 if blind else 0.02)


def test_replay_of_a_flight_sends_the_same_counts():
    with LockStep(*device()) as stack:
        start = flatten(stack.loop.state)
        records = np.frombuffer(stack.run(3000), dtype=RECORD)
    again = replay(device()[0], Segment(0, start, records, ()))
    assert records["resistance_count"][-1] > 2500
    assert again["resistance_count"].tolist() == records["resistance_count"].tolist()
    assert again["torque"].tolist() == [
        codec.decode_out(bytes(one)).torque for one in records["out_frame"]
    ]


def test_board_that_restarts_is_compensated_anew():
    away = InjectionParams("restart", tick=3000)
    servo, board = device()
    with LockStep(servo, replace(board, injections=(away,))) as stack:
        ticks = np.frombuffer(stack.run(5000), dtype=RECORD)
    counts = ticks["resistance_count"].astype(int)
    assert counts[2990] > 2500
    after = counts[3000:3100]
    assert 0 in after
    first = 3000 + int(np.flatnonzero(after == 0)[0])
    steps = np.diff(counts[first:])
    assert steps.max() * COUNT_OHM <= 0.1 * 0.151
    assert counts[-1] == pytest.approx(counts[2990], abs=2)


def test_count_that_is_recorded_is_the_one_on_the_wire_to_the_last_frame():
    with LockStep(*device()) as stack:
        ticks = np.frombuffer(stack.run(1500), dtype=RECORD)
        sent = [codec.decode_out(bytes(one)).resistance for one in ticks["out_frame"]]
        assert sent == ticks["resistance_count"].tolist()
        assert sent[-1] > 2000
        axis = stack.backend._port._axis
        held = axis.resistance_count
    assert axis.resistance_count == held  # as the damping, that the board's watchdog then holds


def test_lying_sensor_never_brings_the_loop_below_minus_0_3():
    """A sensor that reads as hot as it can, stuck or jumping, and any current that switches."""
    random = Random(7)
    nearest = []
    for _ in range(100):
        warm = Warm(params(model_error=0.1), 7.2, 9.0, 15.0)
        for step in range(400):
            if step % 40 == 0:
                ampere = random.choice((0.0, 3.0, 3.8))
                sensor_c = random.choice((119.0, 119.0, 20.0, -300.0))
            warm.look(ampere, sensor_c=sensor_c)
        nearest.append(warm.nearest)
    assert -0.3001 < min(nearest) < -0.2
