"""What leaks is ended by damping and by less stiffness, in time and only then.

The balance is that of the simulated motor: work on the device + change of stored energy - credited
damping x int v^2 dt - what changes brought in.
"""

from itertools import product

import numpy as np
import pytest
from support.boards import board_params
from support.leaking import CREDITED_NS_PER_M, DEVICE_NS_PER_M, Hand, wander
from support.models import device_params, servo_params
from support.servo_energy_controller import (
    BALANCE_J,
    CASES,
    CEILING,
    HANDS,
    against_a_wall,
    flight,
    passive_limit,
    wall,
)

from hapticd.core.params import SafetyParams
from hapticd.mailbox.layout import Command, Value
from hapticd.model.params import HandParams, TouchParams
from hapticd.protocol.view import as_records
from hapticd.run.lockstep import LockStep
from hapticd.servo.safety import State


@pytest.mark.parametrize(("lag_hz", "delay", "hand"), CASES)
def test_wall_at_five_times_its_limit_stays_bounded(lag_hz, delay, hand):
    for seed in range(3):
        held = against_a_wall(True, seed, lag_hz, delay, hand)
        assert held.plan.state is State.ENABLED
        assert max(held.leaks) <= BALANCE_J
        assert held.acted
        assert held.blob["active_damping_ns_per_m"] == pytest.approx(CEILING)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("lag_hz", "delay", "hand"), CASES)
def test_free_motion_and_a_passive_spring_are_left_alone(lag_hz, delay, hand, seed):
    """A spring at 0.9 of what the credited damping allows, held and swung by a hand."""
    credited = CREDITED_NS_PER_M / DEVICE_NS_PER_M * passive_limit(delay, lag_hz)
    held = Hand(HANDS[hand].mass_kg, 30.0, 0.5, wander_n=1.0)
    for stiffness in (0.0, 0.9 * credited):
        calm = flight(True, held, delay, lag_hz)
        calm.begun({Value.STIFFNESS: stiffness})
        calm.pushed(wander(held, 1500, seed))
        assert not calm.acted
        assert np.ptp(calm.positions) > 5e-3


@pytest.mark.parametrize("on", [True, False])
def test_whole_stack_leans_on_a_wall_at_five_times_its_limit(on):
    """The simulated board, whose damping circuit reports what it does; 1 N on the handle."""
    device = device_params(physical_damping_ns_per_m=CREDITED_NS_PER_M)
    safety = SafetyParams(limit_cycle_faults=on, energy_controller=on)
    touch = TouchParams(hands=(HandParams("push", 1.0, force_n=1.0),))
    with LockStep(servo_params(device=device, safety=safety), board_params(touch=touch)) as stack:
        stack.run(5)
        asked = wall(5.0 * passive_limit(0.125, 0.0)) | {Value.RAMP_S: 0.0}
        stack.do(Command.SET, asked)
        stack.do(Command.ENABLE)
        records = as_records(stack.run(2500))
    assert records["state"][-1] == State.ENABLED
    moves = np.ptp(records["position_m"][-300:])
    if not on:
        assert moves > 0.01
        return
    assert moves < 2e-6
    assert np.abs(records["position_m"]).max() < 2e-3
    assert records["excess_j"].max() < 2e-3
    assert records["active_damping_effect_ns_per_m"][-1] == pytest.approx(CEILING)


@pytest.mark.parametrize("seed", range(3))
def test_long_good_credit_does_not_delay_it(seed):
    """Ten seconds of free motion with 1.74 N s/m of active damping, then that damping off and a
    wall at five times its limit.
    """
    swung = Hand(0.008, 30.0, 0.5, wander_n=1.0)
    late = flight(True, swung)
    late.begun({Value.ACTIVE_DAMPING: 1.74, Value.ACTIVE_DAMPING_ON: 1.0})
    late.pushed(wander(swung, 10_000, seed))
    credit_j = -late.leaks[-1]
    assert credit_j > 0.02
    assert not late.acted
    late.do(Command.DAMPING, {Value.ACTIVE_DAMPING_ON: 0.0})
    late.pushed([0.0] * 1000)  # at rest
    before = len(late.leaks)
    late.do(Command.SET, wall(5.0 * passive_limit(0.125, 0.0)) | {Value.RAMP_S: 0.0})
    late.hand = HANDS["bare"]
    late.pushed(wander(late.hand, 1200, seed))
    assert late.acted
    fresh = np.array(late.leaks[before:])
    assert (fresh - np.minimum.accumulate(fresh)).max() <= BALANCE_J


@pytest.mark.parametrize(("delay", "hand"), list(product((0.125, 0.5, 1.125), HANDS)))
def test_device_without_active_damping_gives_up_stiffness(delay, hand):
    """Its ceiling is 0: the cut comes at once."""
    for seed in range(2):
        held = against_a_wall(
            True, seed, 0.0, delay, hand, damps=False, active_damping_limit_ns_per_m=0.0
        )
        assert held.plan.state is State.ENABLED
        assert max(held.leaks) <= BALANCE_J
        assert held.blob["wall_stiffness_n_per_m"] < 1.3 * passive_limit(delay, 0.0)
