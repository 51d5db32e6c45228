"""The compensation of the winding's resistance follows it from below, whatever sensor, current and
board do. The winding itself is integrated here, by its differential equation alone.
"""

import marshal
from dataclasses import replace
from math import pi, sin
from pathlib import Path
from random import Random

import numpy as np
import pytest
from support.flight import HEALTHY, Flight
from support.models import servo_params
from support.servo_compensation import ABLE, CEILING, COUNT_A, COUNT_OHM, Warm, copper, params
from support.winding_table import TABLE

from hapticd.core.faults import BY_CODE
from hapticd.core.params import ScaleParams
from hapticd.mailbox import layout
from hapticd.mailbox.layout import Command, Value
from hapticd.servo.compensation import compensated
from hapticd.servo.connection import uncompensated
from hapticd.servo.plan import (
    NO_TEMPERATURE,
    SETTLED,
    flatten,
    initial_plan,
    unflatten,
)
from hapticd.servo.step import make_step
from hapticd.settings.load import load
from hapticd.settings.toml import shipped
from hapticd.usb.device import SEED
from hapticd.usb.frames import Capability

BLIND = ABLE | NO_TEMPERATURE


def loop_gain(celsius: float, trim_ohm: float) -> float:
    """g dR / K^2 at the highest damping."""
    return CEILING * (copper(celsius) - 1.5 - trim_ohm) / 1.65**2


def trim(flight: Flight) -> float:
    """What the count that is sent makes of the circuit, ohm."""
    return flight.state[SETTLED].resistance_count * COUNT_OHM


# --- the claim ------------------------------------------------------------------------------------


# --- from below -----------------------------------------------------------------------------------


def test_honest_sensor_leaves_the_tolerance_at_every_temperature():
    warm = Warm(params())
    for step in range(3000):
        left = warm.look(2.2 if step < 150 else 0.0)
        if step in (100, 140, 2999):
            assert left == pytest.approx(0.03, abs=0.008)


def test_sensor_stuck_at_80_degc_over_a_cold_winding_never_over_compensates_by_a_tenth():
    warm = Warm(params())
    for _ in range(2000):
        warm.look(0.0, sensor_c=80.0)
    assert warm.celsius == pytest.approx(20.0)
    assert warm.nearest > -0.1


@pytest.mark.parametrize("ampere", [2.3, 2.6, 3.0])
def test_loop_gain_is_bounded_while_the_ends_of_the_model_part(ampere):
    """The ends of the model part further while the winding heats than they do after a long time:
    without the bound the coldest winding that the numbers allow would come to -1.02 to -1.14.
    """
    warm = Warm(params(model_error=0.15), 8.0 * 0.85, 10.0 * 1.15, 15.0)
    for _ in range(400):
        warm.look(ampere, sensor_c=119.9)
    assert warm.nearest == pytest.approx(-0.3, abs=1e-4)


@pytest.mark.parametrize("sensor_c", [-327.68, 0.0, 15.0])
def test_sensor_that_reads_too_low_only_costs_damping(sensor_c):
    warm = Warm(params())
    for _ in range(300):
        warm.look(3.0)
    for _ in range(300):
        left = warm.look(3.0, sensor_c=sensor_c)
    assert warm.least > 0.02
    assert left > 0.4


def test_sensor_that_dies_is_replaced_by_the_cold_end_of_the_model():
    warm = Warm(params())
    for _ in range(300):
        warm.look(2.5)
    for _ in range(300):
        left = warm.look(2.5, host=BLIND)
    assert warm.plan.winding.low_c < warm.celsius
    assert 0.03 < left < copper(warm.celsius) - copper(warm.plan.winding.low_c) + 0.04
    assert left < 0.5 * (copper(warm.celsius) - 1.5)  # far better than nothing


def test_commanded_force_heats_the_model_where_no_current_is_reported():
    warm = Warm(params(heat_from="force"))
    for _ in range(600):
        warm.look(2.5, host=BLIND, held_n=2.5 * 1.65)
    believed_c = warm.plan.winding.low_c
    assert 60.0 < believed_c < warm.celsius
    for _ in range(600):  # the board has taken the torque: what was asked heats nothing
        warm.look(0.0, host=BLIND, held_n=2.5 * 1.65, status=0)
    assert warm.plan.winding.low_c < 20.0
    assert warm.least > 0.03


def test_current_of_a_pause_is_not_known():
    """No look for 50 s: the one after it may not take its current for that of all this time."""
    servo = params()
    plan = initial_plan(servo)
    for tick in (0, 50_000):
        sample = (0, 1, 2000, 0, ABLE, 0, 0.125, round(3.0 / COUNT_A), 0)
        plan = compensated(plan, sample, 0.0, tick, servo)
    assert plan.winding.low_c == pytest.approx(15.0)
    assert plan.winding.high_c == pytest.approx(25.0)


def test_current_of_any_frequency_is_seen_at_its_mean_square():
    for hertz in (3.0, 10.0, 20.0, 50.0, 100.0):
        servo = params(model_error=0.0)
        plan = initial_plan(servo)
        while plan.winding.tick < 60_000:
            due = plan.winding.due_tick
            ampere = 3.0 * sin(2.0 * pi * hertz * due * 1e-3)
            sample = (0, 1, 2000, 0, ABLE, 0, 0.125, round(ampere / COUNT_A), 0)
            plan = compensated(plan, sample, 0.0, due, servo)
        # 60 s are six time constants: T = ambient + R_th R(T) i^2 with i^2 = 4.5 A^2
        heat = 8.0 * 4.5 * 1.6
        expected = (25.0 + heat * (1.0 - 0.00393 * 20.0)) / (1.0 - heat * 0.00393)
        assert plan.winding.high_c == pytest.approx(expected, rel=0.1)


# --- slew, start, restart, ends of the scale ------------------------------------------------------


def test_count_is_slewed_whatever_the_sensor_does():
    flight = Flight(params())
    sensor = Random(3)
    counts = []
    for _ in range(12_000):
        flight.fly(host=ABLE, celsius=sensor.choice((15.0, 25.0, -100.0)))
        counts.append(trim(flight))
    steps = np.abs(np.diff(counts))
    assert steps.max() <= 0.1 * 0.151  # of the longest time between two looks
    assert np.count_nonzero(steps) > 50
    spans = [abs(counts[k + 1000] - counts[k]) for k in range(0, 11_000, 100)]
    assert max(spans) <= 0.1 * 1.16


def test_count_begins_at_0_and_rises_within_the_slew():
    flight = Flight(params())
    assert trim(flight) == 0.0
    flight.fly(300, host=ABLE, celsius=25.0)
    assert 0.0 < trim(flight) <= 0.1 * 0.3
    flight.fly(4000, host=ABLE, celsius=25.0)
    assert trim(flight) == pytest.approx(copper(25.0) - 1.53, abs=COUNT_OHM)


@pytest.mark.parametrize(
    "away",
    [
        {"arrival": SEED},  # another life of the board
        {"host": HEALTHY},  # a board without the DAC
        {"host": ABLE & ~1, "arrival": -1},  # unplugged
    ],
)
def test_board_that_forgot_its_count_gets_0_and_then_the_slew(away):
    flight = Flight(params())
    flight.fly(5000, host=ABLE, celsius=25.0)
    assert trim(flight) > 0.05
    flight.fly(**{"host": ABLE, "celsius": 25.0, **away})
    assert flight.state[SETTLED].resistance_count == 0
    flight.fly(400, host=ABLE, celsius=25.0)
    assert 0.0 < trim(flight) <= 0.1 * 0.55


def test_lost_frames_leave_the_count_as_it_is():
    flight = Flight(params())
    flight.fly(5000, host=ABLE, celsius=25.0)
    before = flight.state[SETTLED].resistance_count
    for lost in range(1, 500):
        flight.fly(host=ABLE, arrival=-lost)
    assert flight.state[SETTLED].resistance_count == before > 0


def test_latched_states_and_faults_are_compensated_all_the_same():
    flight = Flight(params())
    flight.do(Command.STOP, host=ABLE)
    flight.fly(5000, host=ABLE, celsius=25.0)
    assert trim(flight) == pytest.approx(copper(25.0) - 1.53, abs=COUNT_OHM)


def test_full_scale_is_an_end_and_leaves_more_uncompensated():
    servo = params(full_scale_ohm=0.2, trim=ScaleParams(0.2 / 32767))
    warm = Warm(servo)
    for _ in range(600):
        warm.look(3.0)
    assert warm.plan.winding.dac_count == 32_767
    assert copper(warm.celsius) - 1.7 > 0.1


def test_scale_of_negative_sign_sends_negative_counts():
    up = Warm(params())
    down = Warm(params(trim=ScaleParams(COUNT_OHM, -1)))
    for _ in range(400):
        up.look(2.5)
        down.look(2.5)
    assert abs(down.plan.winding.dac_count + up.plan.winding.dac_count) <= 1
    assert up.plan.winding.dac_count > 1000
    flight = Flight(params(trim=ScaleParams(COUNT_OHM, -1)))
    flight.fly(3000, host=ABLE, celsius=25.0)
    assert flight.blob["resistance_count"] == flight.state[SETTLED].resistance_count < -1000


def test_over_temperature_ends_force_as_ever():
    flight = Flight(params())
    flight.do(Command.ENABLE, host=ABLE)
    flight.fly(600, host=ABLE, celsius=119.0)
    assert flight.plan.fault == 0
    flight.fly(host=ABLE, celsius=120.5)
    assert flight.plan.fault == BY_CODE["over_temperature"].number


# --- beside it ------------------------------------------------------------------------------------


def test_between_looks_a_tick_takes_the_short_way():
    """Looks are the only reason to wake a calm servo: 10 in a second."""
    flight = Flight(params())
    flight.fly(3000, host=ABLE, celsius=25.0)
    looks = set()
    for _ in range(10_000):
        settled = flight.state[SETTLED]
        assert settled.wake_tick == flight.plan.winding.due_tick
        looks.add(settled.wake_tick)
        flight.fly(host=ABLE, celsius=25.0)
    assert 95 <= len(looks) <= 106


def test_device_without_the_table_never_wakes_for_it():
    flight = Flight(servo_params())
    flight.fly(300, host=ABLE, celsius=80.0)
    assert flight.state[SETTLED].wake_tick > 1 << 60
    assert flight.blob["resistance_count"] == 0


def test_slots_lost_at_a_look_let_the_damping_step_no_further():
    """The look's own slot was lost; a damping command in the next tick has its slew from there."""
    flight = Flight(params())
    flight.fly(3000, host=ABLE, celsius=25.0)
    flight.tick = flight.plan.winding.due_tick + 80
    asked = {Value.ACTIVE_DAMPING: 5.0, Value.ACTIVE_DAMPING_ON: 1.0}
    flight.do(Command.DAMPING, asked, host=ABLE, celsius=25.0)
    assert flight.plan.added <= 20.0 * 1e-3 * 1.001


def test_checkpoint_in_the_middle_goes_on_to_the_same_bits():
    flight = Flight(params())
    flight.fly(2345, host=ABLE, celsius=25.0, current=4000)
    plain = marshal.loads(marshal.dumps(flatten(flight.state)))
    other = unflatten(plain)
    step = make_step(flight.params)
    assert other[SETTLED].resistance_count == flight.state[SETTLED].resistance_count > 0
    for tick in range(flight.tick, flight.tick + 1500):
        flight.fly(host=ABLE, celsius=25.0, current=4000)
        sample = (0, 0, 2500, 0, ABLE, 0, 0.125, 4000, 0)
        other, _ = step(other, (), sample, tick)
        assert other[SETTLED].blob == flight.state[SETTLED].blob


def test_board_that_follows_its_winding_by_itself_gets_0():
    dac = Capability.RESISTANCE
    assert uncompensated(dac) == ""
    assert "by itself" in uncompensated(dac | Capability.RESISTANCE_TRACKED)
    assert "no resistance DAC" in uncompensated(Capability.TEMPERATURE)


def test_shipped_device_is_the_one_of_these_tests(tmp_path: Path):
    (tmp_path / "hapticd.toml").write_text('device = "warming"\n')
    shown = load(tmp_path / "hapticd.toml").device.resistance.params()
    trim_scale = replace(shown.trim, measured_on="", source="")
    assert replace(shown, trim=trim_scale) == TABLE
    assert (shipped("config") / "devices" / "warming.toml").is_file()


def test_layout_keeps_the_sign_of_the_count():
    assert ("resistance_count", "<i4") in layout.TELEMETRY
