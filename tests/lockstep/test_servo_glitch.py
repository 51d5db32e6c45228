"""One bad encoder sample moves less than 1 N; a struck handle is no glitch; a burst is a fault."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from support.boards import board_params
from support.flight import Flight, enabled
from support.models import COUNT_M
from support.recorded import RecordedFlight
from support.servo_glitch import FELT, LIMIT, params_with

from hapticd.core.faults import BY_CODE
from hapticd.mailbox.layout import Command, Flag, Result, Value
from hapticd.model.params import InjectionParams
from hapticd.protocol.view import as_records
from hapticd.recording import replay
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import SETTLED
from hapticd.servo.safety import State

STRUCK_AT = 900
ENABLED_AT = 504  # ticks that `enabled` takes
JUDGED = Flag.DOUBTED | Flag.GLITCH | Flag.BELIEVED
GLITCH_FAULT = BY_CODE["sensor_glitch"].number
SIZES_MM = [0.05, 0.2, 0.3, 0.4, 0.45, 0.49, 0.51, 0.6, 1.0, 2.0, 3.0, 4.0, 4.5]


def forces_at_the_motor(limit, glitch_m):
    """Forces [N] after each tick of a handle that noise moves, one bad sample among them."""
    counts = round(glitch_m / COUNT_M)
    bad = (InjectionParams("encoder_jump", tick=STRUCK_AT, value=counts),) if counts else ()
    with LockStep(params_with(limit), board_params(injections=bad)) as stack:
        stack.run(5)
        stack.do(Command.SET, FELT)
        stack.do(Command.ENABLE)
        noise = np.random.default_rng(5).integers(-20_000, 20_001, 300).repeat(12)
        stack.load_waveform(noise.tolist())
        stack.do(Command.PERTURB_START, {Value.SAMPLES: float(len(noise)), Value.LOOP: 1.0})
        stack.run(STRUCK_AT - stack.loop.tick - 5)
        board = stack.backend._port.board if bad else stack.backend._port
        forces = []
        flags = 0
        for _ in range(200):
            flags |= int(as_records(stack.run(1))["flags"][-1])
            forces.append(board._axis.force_n)
        last = as_records(stack.run(1))[-1]
        assert last["state"] == State.ENABLED, (last["fault"], flags)
    return np.array(forces), flags


@pytest.fixture(scope="module")
def true_forces():
    forces, flags = forces_at_the_motor(LIMIT, 0.0)
    assert not flags & JUDGED
    assert np.abs(forces).max() > 0.5
    return forces


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("size_mm", SIZES_MM)
def test_one_bad_sample_moves_less_than_a_newton(true_forces, size_mm, sign):
    """Beyond the true force at the simulated motor, with all that follows."""
    forces, flags = forces_at_the_motor(LIMIT, sign * size_mm * 1e-3)
    assert np.abs(forces - true_forces).max() < 1.0
    if not 0.2 < size_mm <= 0.6:  # the motion decides
        assert bool(flags & Flag.GLITCH) is (size_mm > 0.6)


def test_what_is_believed_at_once_moves_much_more(true_forces):
    """The defect itself, of which the number is known: 2.7 N by the law at 4 mm."""
    forces, _ = forces_at_the_motor(math.inf, 4e-3)
    assert np.abs(forces - true_forces).max() > 2.5


def moving(tick, speed=0.3, hz=4.0):
    """Encoder count of a hand."""
    angular = 2.0 * math.pi * hz * 1e-3
    return round(speed / (1000.0 * angular) * math.sin(angular * (tick - ENABLED_AT)) / COUNT_M)


def flown(flight, ticks, extra=lambda tick: 0):
    return [flight.fly(1, encoder=moving(flight.tick) + extra(flight.tick)) for _ in range(ticks)]


@pytest.mark.parametrize("counts", [-9000, -2000, 2000, 9000])
def test_the_law_goes_on_as_if_the_bad_sample_had_been_lost(counts):
    bad = enabled(params_with(), FELT)
    flown(bad, 300)
    lost = enabled(params_with(), FELT)
    flown(lost, 300)
    at = bad.tick
    outs = flown(bad, 2, lambda tick: counts if tick == at else 0)
    lost.fly(1, arrival=-1)
    lost.fly(1, encoder=moving(lost.tick), arrival=1)
    assert outs[0][9] & Flag.DOUBTED
    assert outs[1][9] & Flag.GLITCH
    assert bad.state[1] == lost.state[1]
    # in place of the bad position: the straight continuation
    assert outs[0][1] == pytest.approx(moving(at) * COUNT_M, abs=1e-5)
    assert flown(bad, 50)[-1][:4] == flown(lost, 50)[-1][:4]


@pytest.mark.parametrize("counts", [-950, -650, 650, 950])
def test_a_glitch_too_small_to_be_doubted_is_taken_back(counts):
    bad = enabled(params_with(), FELT)
    flown(bad, 300)
    lost = enabled(params_with(), FELT)
    flown(lost, 300)
    at = bad.tick
    outs = flown(bad, 2, lambda tick: counts if tick == at else 0)
    lost.fly(1, arrival=-1)
    lost.fly(1, encoder=moving(lost.tick), arrival=1)
    assert not outs[0][9] & JUDGED
    assert outs[1][9] & Flag.GLITCH
    assert bad.state[1] == lost.state[1]
    assert outs[1][1] == moving(at + 1) * COUNT_M


def ticks_to_fault(flight, extra, most=60):
    for ticks in range(1, most):
        flown(flight, 1, extra)
        if flight.plan.state is State.FAULT:
            return ticks
    return most


@pytest.mark.parametrize("seed", range(50))
def test_a_burst_is_a_fault_within_ten_ticks(seed):
    random = np.random.default_rng(seed)
    flight = enabled(params_with(), FELT)
    flown(flight, 100)
    most = round(2.2e-3 / COUNT_M)

    def burst(_):
        return int(random.integers(-most, most + 1))

    assert ticks_to_fault(flight, burst) <= 10
    assert flight.blob["fault"] == GLITCH_FAULT
    assert not flight.plan.homed
    forces = [flight.out[8], *(out[8] for out in flown(flight, 25, burst))]
    # the encoder that lies has no say in it
    assert all(abs(b) <= abs(a) for a, b in pairwise(forces))
    assert forces[-1] == 0.0


def test_every_second_sample_bad_is_a_fault_within_ten_ticks():
    flight = enabled(params_with(), FELT)
    flown(flight, 100)
    assert ticks_to_fault(flight, lambda tick: 6000 * (tick % 2)) <= 10
    assert flight.blob["fault"] == GLITCH_FAULT


@pytest.mark.parametrize("counts", [4000, 6000, 9000])
def test_a_position_that_jumps_and_stays_is_a_fault(counts):
    flight = enabled(params_with(), FELT)
    flown(flight, 100)
    from_tick = flight.tick
    forces = []

    def extra(tick):
        return counts if tick >= from_tick else 0

    for _ in range(30):
        forces += [out[8] for out in flown(flight, 1, extra)]
    assert flight.blob["fault"] == GLITCH_FAULT
    assert max(abs(b - a) for a, b in pairwise(forces)) < 0.5


def test_single_glitches_now_and_then_are_no_fault_and_many_in_a_second_are():
    flight = enabled(params_with(glitches_limit=3), FELT)
    for _ in range(12):
        flown(flight, 400)
        at = flight.tick
        flown(flight, 3, lambda tick, at=at: 5000 * (tick == at))
    assert flight.plan.state is State.ENABLED
    flown(flight, 1000)
    for _ in range(4):
        assert flight.plan.state is State.ENABLED
        flown(flight, 50)
        at = flight.tick
        flown(flight, 3, lambda tick, at=at: 5000 * (tick == at))
    assert flight.blob["fault"] == GLITCH_FAULT
    flown(flight, 30)
    assert flight.do(Command.RESET, encoder=moving(flight.tick)) is Result.APPLIED
    refused = flight.do(Command.ENABLE, encoder=moving(flight.tick))
    assert refused is Result.REFUSED_NOT_HOMED  # counts may have been missed
    assert flight.do(Command.ZERO, encoder=moving(flight.tick)) is Result.APPLIED
    assert flight.do(Command.ENABLE, encoder=moving(flight.tick)) is Result.APPLIED
    flown(flight, 500)
    assert flight.plan.state is State.ENABLED


def test_nothing_is_doubted_while_no_force_acts():
    flight = Flight(params_with())
    assert not any(out[9] & JUDGED for out in flown(flight, 100, lambda tick: 3000 * (tick % 2)))
    assert flight.plan.state is State.DISABLED


def test_a_stop_on_its_way_out_is_not_moved_by_a_bad_sample():
    flight = enabled(params_with(), FELT)
    flown(flight, 137)
    flight.do(Command.STOP, encoder=moving(flight.tick))
    at = flight.tick + 3
    forces = [out[8] for out in flown(flight, 25, lambda tick: 8000 * (tick == at))]
    assert max(abs(b - a) for a, b in pairwise(forces)) < 0.4
    assert flight.plan.doubted == ()
    assert not flight.state[SETTLED].out_flags & 1


@pytest.mark.parametrize("arrival", [1, 3, 9])
def test_what_is_doubted_when_frames_are_lost_is_lost_too(arrival):
    flight = enabled(params_with(), FELT)
    flown(flight, 300)
    at = flight.tick
    flown(flight, 1, lambda tick: 8000 * (tick == at))
    for missing in range(1, arrival + 1):
        flight.fly(1, arrival=-min(missing, 8))
    out = flight.fly(1, encoder=moving(flight.tick), arrival=arrival)
    assert flight.plan.state is State.ENABLED
    assert out[9] & (Flag.SEEDED if arrival == 9 else Flag.INTERPOLATED)
    assert out[2] == pytest.approx(0.0 if arrival == 9 else 0.3, abs=0.3)
    assert flight.plan.doubted == ()


def test_glitches_and_taps_are_replayed_bit_by_bit():
    bad: tuple[Any, ...] = tuple(
        InjectionParams("encoder_jump", tick=tick, value=value)
        for tick, value in ((900, 5000), (1200, -900), (1201, 800), (1500, 3000))
    )
    behind_a_loss = (
        InjectionParams("drop_in", tick=1350),
        InjectionParams("encoder_jump", tick=1351, value=5000),
    )
    with RecordedFlight(params_with(), board_params(injections=bad + behind_a_loss)) as flight:
        flight.move()
        flight.fly(1700)
        requests = flight.stack.gateway.journal(0)[0]
        records = flight.records
        kept = flight.publisher.flight._checkpoints
    assert np.bitwise_or.reduce(records["flags"]) & Flag.GLITCH
    for checkpoint in kept:
        since = records[records["tick"] >= checkpoint.tick]
        segment = replay.Segment(checkpoint.tick, checkpoint.state, since, requests)
        assert replay.difference(since, replay.replay(flight.params, segment)) is None
