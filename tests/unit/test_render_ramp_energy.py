"""Ramps and the energy ledger against what they mean."""

import numpy as np
import pytest
from support.held_force import exact_work

from hapticd.render.law import EMPTY, EXCESS, Ramp, approach, book, constant, ledger_at_rest


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


T = 1e-3
KEPT = 1.0


def ledger_of(position_m, force_n, delay, mass=0.0, credited=0.0):
    """After a held force was rendered over `position_m` (n,), all of it elastic."""
    ledger = EMPTY
    last = position_m[0]
    for x, force in zip(position_m.tolist(), force_n.tolist(), strict=True):
        ledger = book(ledger, x - last, force, delay, force, mass, 0.0, credited / T, KEPT)
        last = x
    return ledger


def sine(time):
    return 1e-3 * np.sin(2.0 * np.pi * 20.0 * time)


@pytest.mark.parametrize("delay", [0.0, 0.125, 0.5, 0.875, 1.0, 1.5])
def test_work_of_a_held_spring_is_exact_work(delay):
    """Within 1 % of the leak of exact motion and integration, 20 Hz."""
    position = sine(np.arange(1001) * T)
    exact = exact_work(sine, -1000.0 * position, delay)[-1]
    found = ledger_of(position, -1000.0 * position, delay)
    assert found[0] == pytest.approx(exact, rel=0.01)


def test_uncovered_energy_of_a_spring_is_its_leak_beyond_the_credit():
    """K (T/2 + d T) int v^2 dt less c int v^2 dt: what the theorem compares."""
    position = sine(np.arange(1001) * T)
    square = 0.5 * (1e-3 * 2.0 * np.pi * 20.0) ** 2  # int v^2 dt over whole swings of 1 s
    for credited, uncovered in ((0.0, 0.625), (0.5, 0.125), (0.7, 0.0)):
        found = ledger_of(position, -1000.0 * position, 0.125, credited=credited)
        assert found[EXCESS] == pytest.approx(uncovered * square, abs=0.01 * square)


def test_ramp_of_a_stiffness_is_no_uncovered_energy():
    """Held 5 mm off while K rises to 800 N/m, then let go: 10 mJ come out as they were brought
    in.
    """
    stiffness = np.concatenate((np.linspace(0.0, 800.0, 500), np.full(5000, 800.0)))
    position = np.concatenate((np.full(500, 5e-3), np.linspace(5e-3, 0.0, 5000)))
    found = ledger_of(position, -stiffness * position, 0.125)
    assert found[0] == pytest.approx(0.5 * 800.0 * 5e-3**2, rel=0.01)
    assert found[EXCESS] < 1e-4


def test_rest_forgets_forces_and_keeps_sums():
    found = ledger_of(sine(np.arange(300) * T), np.full(300, 2.0), 0.125)
    assert ledger_at_rest(found) == (found[0], found[1], 0.0, 0.0, 0.0, 0.0, 0.0)
