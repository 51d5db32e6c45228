"""The balance of forces: its closed forms, and made-up records of a handle whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from support.rig_balance import FACTS, runs_of
from support.shaken_handle import Truth, shaken

from hapticd.rig.excitation import noise
from hapticd.rig.experiment import PerturbationRun
from hapticd.rig.steps import force_balance as balance
from hapticd.rig.steps import identify
from hapticd.rig.steps.force_balance import RIGID, fit_rigid_mass
from hapticd.rig.steps.force_terms import clocked
from hapticd.rig.steps.identify import analyse
from hapticd.signal.verdict import student_quantile

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


def contradicted(truth):
    found = analyse(runs_of(truth), FACTS)
    return [one.what for one in found.findings if one.what.startswith("contradicted")]


def test_smoothing_is_told_from_delay_where_it_is_long():
    truth = Truth(smoothing_s=1.5e-3, delay_steps=16)
    values = {one.name: one for one in analyse(runs_of(truth), FACTS).values}
    assert values["smoothing"].low <= 1500.0 <= values["smoothing"].high
    assert values["delay"].low <= 250.0 <= values["delay"].high
    assert values["smoothing"].high - values["smoothing"].low < 300.0


def test_short_smoothing_is_not_told_from_delay_and_the_interval_says_so():
    truth = Truth(smoothing_s=1e-4, delay_steps=16)
    result = analyse(runs_of(truth), FACTS)
    values = {one.name: one for one in result.values}
    assert values["lag"].low <= 350.0 <= values["lag"].high
    assert values["delay"].low <= 250.0 <= values["delay"].high
    assert values["smoothing"].low <= 100.0 <= values["smoothing"].high
    written = {(one.table, one.key): one.value for one in result.changes}
    assert written["model.delay", "periods"] == pytest.approx(0.35, abs=0.01)


def test_viscous_friction_that_differs_by_direction_is_a_contradiction():
    assert any("both directions" in one for one in contradicted(Truth(viscous_more=0.4)))


def test_coulomb_friction_that_differs_by_direction_is_a_contradiction():
    """It cannot be told from a steady pull, and both are named."""
    (told,) = contradicted(Truth(coulomb_more=0.3))
    assert "resists one way" in told


def test_the_pull_of_a_sound_device_is_within_its_interval():
    found = fit_rigid_mass(runs_of(Truth()))
    pull = next(one for one in found.tests if one.name == "pull")
    assert abs(pull.size) <= 2.0 * pull.half
    assert found.fit.sd.shape == (RIGID,)
    assert pull.critical > student_quantile(0.995, found.blocks - 1)


TWO = Truth(mass_kg=0.0067, slider_kg=0.0022, resonance_hz=730.0, smoothing_s=5.5e-4)


@pytest.mark.parametrize("late_samples", [0.0, 0.2])
def test_two_masses_are_told_however_the_velocity_channel_is_late(late_samples):
    """A channel that interpolates is weak at high frequencies, and feigns some of a resonance."""
    truth = replace(TWO, late_samples=late_samples)
    values = {one.name: one for one in analyse(runs_of(truth), FACTS).values}
    true = {
        "moving mass": truth.mass_kg,
        "sliding mass": truth.slider_kg,
        "first resonance": truth.resonance_hz,
        "lag": truth.lag_us,
        "Coulomb friction": truth.coulomb_n,
    }
    for name, value in true.items():
        assert values[name].low <= value <= values[name].high, values[name]
    assert values["moving mass"].high - values["moving mass"].low < 0.01 * truth.mass_kg
    assert values["first resonance"].high - values["first resonance"].low < 0.2 * truth.resonance_hz


def test_a_small_mass_on_a_stiff_transmission_is_told():
    truth = Truth(mass_kg=0.0045, slider_kg=0.00144, resonance_hz=885.0, late_samples=0.07)
    values = {one.name: one for one in analyse(runs_of(truth), FACTS).values}
    for name, true in (("sliding mass", truth.slider_kg), ("first resonance", 885.0)):
        assert values[name].low <= true <= values[name].high


def test_a_late_channel_is_not_taken_for_a_transmission_that_yields():
    result = analyse(runs_of(Truth(late_samples=0.5)), FACTS)
    assert result.settled
    assert "sliding mass" not in {one.name for one in result.values}
    assert not [one.what for one in result.findings if one.what.startswith("contradicted")]


def test_a_mass_that_no_force_could_move_is_refused(monkeypatch):
    found = fit_rigid_mass(runs_of(Truth()))
    assert found.handle.mass_kg <= found.most_kg <= 3.0 * found.handle.mass_kg
    heavy = replace(found, handle=replace(found.handle, mass_kg=0.36), tests=())
    monkeypatch.setattr(identify, "_solved", lambda _: heavy)
    result = analyse(runs_of(Truth()), FACTS)
    assert not result.changes
    assert "moving mass 360 g" in result.findings[0].what


def test_a_balance_that_has_not_settled_is_refused(monkeypatch):
    monkeypatch.setattr(balance, "FIRST_ROUNDS", 1)
    monkeypatch.setattr(balance, "ROUNDS", 1)
    result = analyse(runs_of(Truth()), FACTS)
    assert not result.settled
    assert not result.values
    assert not result.changes
    assert "not settled" in result.findings[0].what


def test_the_probes_clock_is_found_by_the_motion():
    run = shaken(Truth(), noise(8.0, 0.7, 1), 20.0, 0.3, 0)
    late = PerturbationRun(run.board_us + 90.0, *list(vars(run).values())[1:])
    found = clocked(late)
    assert found.phase_us == pytest.approx(90.0, abs=0.5)
    assert found.gain == pytest.approx(1.0, abs=2e-3)
