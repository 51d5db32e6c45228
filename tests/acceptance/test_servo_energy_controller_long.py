"""What leaks is ended by damping and by less stiffness, in time and only then.

The balance is that of the simulated motor: work on the device + change of stored energy - credited
damping x int v^2 dt - what changes brought in.
"""

import numpy as np
import pytest
from support.leaking import CREDITED_NS_PER_M, DEVICE_NS_PER_M, Hand, wander
from support.servo_energy_controller import (
    BALANCE_J,
    CASES,
    CEILING,
    HANDS,
    against_a_wall,
    flight,
    passive_limit,
)

from hapticd.mailbox.layout import Value
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
