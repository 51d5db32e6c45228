"""Ramps and the energy ledger against what they mean."""

import math

import pytest

from hapticd.render.energy import EMPTY, book
from hapticd.render.ramp import Ramp, approach, constant


def test_ramp_arrives_exactly_on_its_end_tick():
    ramp = Ramp(1.0, 3.0, 100, 50)
    assert [ramp.value(tick) for tick in (99, 100, 125, 149, 150, 151)] == pytest.approx(
        [1.0, 1.0, 2.0, 2.96, 3.0, 3.0]
    )
    assert ramp.value(150) == 3.0
    assert ramp.running(149)
    assert not ramp.running(150)


def test_new_ramp_starts_where_the_old_one_is():
    first = Ramp(0.0, 10.0, 0, 100)
    second = first.towards(2.0, 40, 10)
    assert second.value(40) == pytest.approx(first.value(40))
    assert second.value(50) == 2.0


def test_ramp_of_no_length_is_a_step():
    assert constant(5.0).towards(7.0, 10, 0).value(10) == 7.0


def test_slew_reaches_its_target_and_stays():
    assert approach(0.0, 1.0, 0.4) == 0.4
    assert approach(0.8, 1.0, 0.4) == 1.0
    assert approach(0.0, -1.0, 0.4) == -0.4


def ledger_of(positions, stiffness, delay):
    """Energies after a spring was rendered over `positions`, sampled and held."""
    ledger = EMPTY
    last = positions[0]
    for x in positions:
        force = -stiffness * x
        ledger = book(ledger, x - last, (force, 0.0, 0.0, 0.0, force), delay, 0.0)
        last = x
    return ledger[0]


def exact_work(positions, stiffness, delay):
    """Work of the held force on motion that is straight between samples."""
    work = 0.0
    for k in range(len(positions) - 2):
        way = (1 - delay) * (positions[k + 1] - positions[k]) + delay * (
            positions[k + 2] - positions[k + 1]
        )
        work += -stiffness * positions[k] * way
    return work


@pytest.mark.parametrize("delay", [0.0, 0.125, 0.5])
def test_ledger_is_the_exact_work_of_the_held_force(delay):
    positions = [1e-3 * math.sin(2 * math.pi * 20.0 * n / 1000.0) for n in range(1001)]
    energies = ledger_of(positions, 1000.0, delay)
    assert energies[0] == pytest.approx(exact_work(positions, 1000.0, delay), rel=1e-12)
    assert energies[4] == energies[0]


def test_held_spring_leaks_energy_to_the_user():
    """K A^2 N (1 - cos wT) / 2 for N ticks of a sine: 3.94 mJ for 1000 N/m, 1 mm, 20 Hz, 1 s;
    exact delivery is positive.
    """
    positions = [1e-3 * math.sin(2 * math.pi * 20.0 * n / 1000.0) for n in range(1001)]
    closed_form = 1000.0 * 1e-6 * 1000 / 2 * (1 - math.cos(2 * math.pi * 20.0 / 1000.0))
    assert ledger_of(positions, 1000.0, 0.0)[0] == pytest.approx(closed_form, rel=5e-3)


def test_added_damping_entry_only_falls():
    ledger = EMPTY
    for displacement in (1e-6, -2e-6, 0.0):
        ledger = book(ledger, displacement, (0.0,) * 5, 0.125, 1740.0)
    assert ledger[0][5] == pytest.approx(-1740.0 * 5e-12)
