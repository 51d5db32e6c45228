"""No rhythm of changes pumps a hand: what they bring in within a second has a budget."""

import math

import numpy as np
import pytest
from support.boards import board_params
from support.flight import Flight, enabled
from support.pump import toggled
from support.recorded import RecordedFlight
from test_servo_ramp_energy import SOFT, TEN_MM, budgeted, hand

from hapticd.core.params import RAMP_ENERGY_J
from hapticd.mailbox.layout import Command, Flag, Value
from hapticd.recording import replay
from hapticd.servo.energy import spring_energy


@pytest.mark.parametrize("damping", [0.0, 2.0])
@pytest.mark.parametrize("budget_j", [0.01, RAMP_ENERGY_J])
def test_budget_bounds_the_toggled_spring(damping, budget_j):
    """For 13 s; without a budget it reaches the clamp within two."""
    flight = hand(budget_j, damping, 5e-3)
    assert max(toggled(flight, 60)) < 2.0 * budget_j
    assert max(toggled(hand(math.inf, damping, 5e-3), 12)) > 0.12


def upward_energy(flight, ticks, command):
    """What rises of K brought in, tick by tick, from records."""
    found = []
    stiffness = flight.blob["stiffness_n_per_m"]
    for n in range(ticks):
        command(n)
        now = flight.blob["stiffness_n_per_m"] * flight.blob["gain"]
        x = flight.out[1]
        found.append(max(0.0, spring_energy(now, x, 8.0) - spring_energy(stiffness, x, 8.0)))
        stiffness = now
    return np.array(found)


@pytest.mark.parametrize("seed", range(3))
def test_no_second_brings_in_more_than_the_budget(seed):
    """Changes of K at random while a hand moves at random; whatever window is looked at."""
    random = np.random.default_rng(seed)
    flight = enabled(budgeted(), SOFT)

    def command(n):
        encoder = round(TEN_MM * math.sin(0.02 * n + math.sin(0.0031 * n)))
        asked = {Value.STIFFNESS: random.uniform(-100.0, 500.0), Value.RAMP_S: 0.02}
        if n % 40:
            flight.fly(1, encoder=encoder)
        else:
            flight.do(Command.SET, asked, encoder=encoder)

    whole = np.concatenate(([0.0], np.cumsum(upward_energy(flight, 6000, command))))
    windows = whole[1000:] - whole[:-1000]
    assert 0.7 * RAMP_ENERGY_J < windows.max() <= RAMP_ENERGY_J * (1.0 + 1e-9)


def test_clamped_spring_stores_no_more_than_its_clamped_force_did():
    """K = 1e5 N/m 19 mm off: 152 mJ at 8 N, not 18 J."""
    flight = Flight(budgeted(), 38_000)
    flight.do(Command.SET, {Value.STIFFNESS: 1e5, Value.RAMP_S: 0.0})
    flight.do(Command.ENABLE)
    flight.fly(5600)
    assert flight.blob["gain"] == 1.0
    exact = 8.0 * 0.019 - 8.0**2 / (2.0 * 1e5)
    assert spring_energy(1e5, -0.019, 8.0) == pytest.approx(exact)


def test_pump_that_pauses_is_replayed_bit_by_bit():
    """The whole stack, with a handle of 1 kg that a push sets moving."""
    params = budgeted(0.005)
    with RecordedFlight(params, board_params(mass_kg=1.0, viscous_ns_per_m=0.5)) as flight:
        flight.set_off(40.0, [32767] * 200)
        for n in range(20):
            stiffness = 380.0 if n % 2 == 0 else 40.0
            flight.stack.command(Command.SET, {Value.STIFFNESS: stiffness, Value.RAMP_S: 0.05})
            flight.fly(110)
        records = flight.records
        leg = flight.leg()
    assert (records["flags"] & Flag.PAUSED).any()
    assert replay.difference(leg.records, replay.replay(params, leg)) is None
