"""A bad encoder sample behind lost frames, and parameters that change while a sample is doubted."""

import json
import math

import numpy as np
import pytest
from support.flight import Flight, enabled
from support.models import COUNT_M, device_params, servo_params
from support.pump import HeldFlight
from support.servo_glitch import FELT, params_with

from hapticd.core.environment import Environment
from hapticd.mailbox.layout import Command, Flag, Result, Value
from hapticd.servo.plan import flatten, unflatten
from hapticd.servo.safety import State

AT = 40  # tick of the bad sample
SIZES_MM = (0.4, 0.49, 0.6, 1.0, 2.0, 4.0, -3.0, 20.0)
WRAP = 1 << 31


def begun(params, encoder=0):
    """A flight, and a function that puts it back to its start."""
    flight = enabled(params, FELT, encoder)
    start = flight.tick, flight.state

    def again():
        flight.tick, flight.state = start

    return flight, again


def counted(flight, position_m, first=0):
    """The count of an encoder of 32 bits that began at `first`."""
    count = first + round(position_m / COUNT_M)
    return (count + WRAP) % (2 * WRAP) - WRAP


def passed(flight, positions_m, at, lost, slots, first=0):
    """Outputs by tick for a handle at `positions_m`, `lost` frames before `at` included."""
    found = {}
    for tick, position_m in enumerate(positions_m):
        early = at - tick
        if not 0 < early <= lost:
            arrival = lost if tick == at else 0
            encoder = counted(flight, position_m, first)
            found[tick] = flight.fly(encoder=encoder, arrival=arrival)
        elif slots:
            flight.tick += 1
        else:
            found[tick] = flight.fly(arrival=early - lost - 1)
    return found


def hand(amplitude_m_per_s):
    """Positions [m] of a hand at 4 Hz."""
    angular = 2.0 * math.pi * 4e-3
    return [
        1e-3 * amplitude_m_per_s / angular * math.sin(angular * tick) for tick in range(AT + 30)
    ]


@pytest.mark.parametrize("slots", [False, True])
@pytest.mark.parametrize("lost", [1, 2, 5, 8])
@pytest.mark.parametrize("speed_m_per_s", [0.0, 0.3])
def test_one_bad_sample_behind_lost_frames_moves_less_than_a_newton(lost, slots, speed_m_per_s):
    flight, again = begun(params_with())
    path = hand(speed_m_per_s)
    true = passed(flight, path, AT, lost, slots)
    for size_mm in SIZES_MM:
        again()
        bad = [x + 1e-3 * size_mm * (tick == AT) for tick, x in enumerate(path)]
        outs = passed(flight, bad, AT, lost, slots)
        assert max(abs(outs[tick][8] - true[tick][8]) for tick in true) < 1.0, size_mm
        assert flight.plan.state is State.ENABLED
        if abs(size_mm) > 1.0:
            assert outs[AT][9] & Flag.DOUBTED
            assert outs[AT + 1][9] & Flag.GLITCH
            assert len(flight.plan.glitches) == 1


@pytest.mark.parametrize("lost", [1, 3, 8])
@pytest.mark.parametrize("acceleration_m_per_s2", [20.0, 100.0, 300.0, 490.0])
def test_true_motion_behind_lost_frames_reaches_the_law_a_tick_later_at_most(
    acceleration_m_per_s2, lost
):
    """The handle is accelerated for 10 ms, as fast as the device allows, and frames are lost at any
    time of it. What is doubted is as true as without a limit once the next sample came.
    """
    pushed = np.isin(np.arange(45), np.arange(20, 30))
    path = np.cumsum(np.cumsum(1e-6 * acceleration_m_per_s2 * pushed)).tolist()
    handle, again = begun(params_with())
    trusting, trust_again = begun(params_with(math.inf))
    for at in range(20, 40, 3):
        again()
        trust_again()
        outs = passed(handle, path, at, lost, True)
        true = passed(trusting, path, at, lost, True)
        doubts = [tick for tick, out in outs.items() if out[9] & Flag.DOUBTED]
        assert doubts in ([], [at], [at + 1])
        assert not any(out[9] & Flag.GLITCH for out in outs.values())
        assert handle.plan.state is State.ENABLED
        assert all(outs[tick][:9] == true[tick][:9] for tick in outs if tick not in doubts)


@pytest.mark.parametrize("lost", [1, 5])
def test_a_glitch_behind_lost_frames_over_the_wrap_of_the_encoder_is_the_same(lost):
    path = [2e-4 * tick for tick in range(AT + 30)]
    path[AT] += 4e-3
    first = WRAP - round(path[AT - 1] / COUNT_M)
    plain, wrapped = (enabled(params_with(), FELT, count) for count in (0, first))
    for flight in (plain, wrapped):
        flight.do(Command.DISABLE)
        assert flight.do(Command.ZERO) is Result.APPLIED
        flight.do(Command.ENABLE)
        flight.fly(500)
    outs = passed(plain, path, AT, lost, True)
    assert outs[AT + 1][9] & Flag.GLITCH
    assert passed(wrapped, path, AT, lost, True, first) == outs


@pytest.mark.parametrize("lost", [1, 3])
def test_a_frame_that_is_lost_behind_a_doubted_tap_ends_nothing(lost):
    """4.6 m/s in one tick. The first sample of it arrives, the next ones are lost."""
    path = [4.6e-3 * max(0, tick - 20) for tick in range(30)]
    flight, _ = begun(params_with())
    outs = passed(flight, path, 22 + lost, lost, True)
    assert outs[21][9] & Flag.DOUBTED
    assert flight.plan.state is State.ENABLED
    assert not any(out[9] & Flag.GLITCH for out in outs.values())


@pytest.mark.parametrize("slots", [False, True])
@pytest.mark.parametrize("lost", [1, 2, 3, 5, 8])
@pytest.mark.parametrize("speed_m_per_s", [0.0, 0.3, 1.2])  # up to 30 m/s^2
def test_a_bad_sample_before_lost_frames_is_lost_with_them(lost, slots, speed_m_per_s):
    flight, again = begun(params_with())
    path = hand(speed_m_per_s)
    at = AT + lost + 1
    true = passed(flight, path, at, lost, slots)
    for size_mm in (1.0, 2.0, 3.0, 4.0, -3.0):
        again()
        bad = [x + 1e-3 * size_mm * (tick == AT) for tick, x in enumerate(path)]
        outs = passed(flight, bad, at, lost, slots)
        assert outs[AT][9] & Flag.DOUBTED
        assert flight.plan.state is State.ENABLED
        assert max(abs(outs[tick][8] - true[tick][8]) for tick in true if tick > at) < 1.0


def test_an_encoder_that_is_bad_between_lost_frames_begins_anew_without_force():
    flight, _ = begun(params_with())
    for place in range(12):
        flight.fly(arrival=-1)
        flight.fly(encoder=8000 * (1 + place % 2), arrival=1)
        if flight.out[9] & Flag.SEEDED:
            break
    assert flight.out[9] & Flag.SEEDED
    assert place < 8
    assert abs(flight.out[8]) < 0.1


def test_checkpoint_carries_a_lost_frame_before_a_doubted_sample():
    flight, _ = begun(params_with())
    flight.fly(arrival=-1)
    flight.fly(encoder=8000, arrival=1)
    assert flight.plan.doubted == (None, 8000)
    plain = json.loads(json.dumps(flatten(flight.state)))
    assert unflatten(plain) == flight.state


def test_zero_behind_a_lost_frame_needs_a_sample_that_continues_the_motion():
    for jump_m, continues in ((8e-4, False), (0.0, True)):
        flight = Flight(params_with())
        for tick in range(20):
            flight.fly(encoder=round(8e-4 * tick / COUNT_M))  # 0.8 m/s
        flight.fly(arrival=-1)
        encoder = round((8e-4 * 21 + jump_m) / COUNT_M)
        found = flight.do(Command.ZERO, encoder=encoder, arrival=1)
        assert (found is Result.APPLIED) is continues


# --- parameters -----------------------------------------------------------------------------------

WALL = {
    Value.WALL_STIFFNESS: 4000.0, Value.WALL_POSITION: 0.008, Value.WALL_SIDE: 1.0,
}  # fmt: skip


def eased(change, budget_j, ticks):
    """A handle that is held at 10 mm, `ticks` after a change with a ramp of 0."""
    device = device_params(
        acceleration_limit_m_per_s2=500.0, ramp_energy_j=budget_j, force_step_n=1.0
    )
    params = servo_params(device=device, environment=Environment(0.0, 1.0))
    flight = HeldFlight(params, 1e6, 0.0, 0.01)
    flight.do(Command.ENABLE)
    flight.fly(502)
    flight.do(Command.SET, {**change, Value.RAMP_S: 0.0})
    flight.fly(ticks)
    return flight


@pytest.mark.parametrize(
    ("change", "budget_j", "ticks"),
    [
        ({Value.STIFFNESS: 2000.0}, 0.03, 4),
        ({Value.STIFFNESS: 2000.0}, math.inf, 4),
        ({Value.STIFFNESS: 2000.0}, 0.03, 300),  # it waits for its energy
        (WALL, 0.03, 2),
    ],
)
def test_a_bad_sample_lets_no_step_of_parameters_through(change, budget_j, ticks):
    """Where the handle seems to be, the change makes no force."""
    flight = eased(change, budget_j, ticks)
    before_n = flight.out[8]
    assert before_n < -0.5
    flight.fly(encoder=0)
    assert abs(flight.out[8] - before_n) < 0.1
    for _ in range(5):
        last_n = flight.out[8]
        flight.fly()
        assert abs(flight.out[8] - last_n) <= 1.0


def test_a_wrap_of_the_encoder_lets_no_step_of_parameters_through():
    flight = eased({Value.STIFFNESS: 2000.0}, math.inf, 4)
    for _ in range(3):
        last_n = flight.out[8]
        flight.fly(encoder=round(0.01 / COUNT_M) - 2 * WRAP)
        assert abs(flight.out[8] - last_n) <= 1.0
    assert flight.out[8] < -3.5
