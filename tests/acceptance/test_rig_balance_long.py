"""The balance of forces: its closed forms, and made-up records of a handle whose truth is known."""

import numpy as np
import pytest
from support.rig_balance import FACTS, runs_of
from support.shaken_handle import Truth

from hapticd.rig.steps.identify import analyse

SEEDS = range(8)


@pytest.fixture(scope="module")
def several():
    """(result, truth) of several devices."""
    found = []
    for seed in SEEDS:
        random = np.random.default_rng(seed)
        truth = Truth(
            mass_kg=random.uniform(0.004, 0.012),
            viscous_ns_per_m=random.uniform(0.2, 0.6),
            coulomb_n=random.uniform(0.02, 0.06),
            delay_steps=int(random.integers(8, 60)),
            noise_m_per_s=random.uniform(0.2e-4, 2e-4),
        )
        found.append((analyse(runs_of(truth, seed), FACTS), truth))
    return found


@pytest.mark.slow
def test_intervals_hold_the_truth(several):
    names = ("moving mass", "viscous friction", "Coulomb friction", "lag")
    inside = dict.fromkeys(names, 0)
    for result, truth in several:
        true = {
            "moving mass": truth.mass_kg,
            "viscous friction": truth.viscous_ns_per_m,
            "Coulomb friction": truth.coulomb_n,
            "lag": truth.lag_us,
        }
        for one in result.values:
            if one.name in inside:
                inside[one.name] += one.low <= true[one.name] <= one.high
    assert sum(inside.values()) >= 0.92 * len(several) * len(inside), inside


@pytest.mark.slow
def test_no_assumption_is_contradicted_where_all_hold(several):
    told = [one.what for result, _ in several for one in result.findings if one.verdict != "ok"]
    assert not told


@pytest.mark.slow
def test_intervals_are_narrow(several):
    """A tenth of friction, a twentieth of a period."""
    for result, truth in several:
        half = {one.name: 0.5 * (one.high - one.low) for one in result.values}
        assert half["viscous friction"] <= 0.1 * truth.viscous_ns_per_m
        assert half["Coulomb friction"] <= 0.1 * truth.coulomb_n
        assert half["lag"] <= 50.0
