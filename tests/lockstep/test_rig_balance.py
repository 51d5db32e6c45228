"""The balance of forces: its closed forms, and made-up records of a handle whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from support.rig_balance import FACTS, runs_of
from support.shaken_handle import Truth, shaken

from hapticd.core.errors import AnalysisError
from hapticd.rig.excitation import noise
from hapticd.rig.experiment import PerturbationRun
from hapticd.rig.steps import force_balance as balance
from hapticd.rig.steps import identify
from hapticd.rig.steps.force_balance import RIGID, fit_rigid_mass
from hapticd.rig.steps.force_terms import Clock, Handle, clocked, commanded, friction
from hapticd.rig.steps.identify import analyse
from hapticd.signal.verdict import student_quantile


def contradicted(truth):
    found = analyse(runs_of(truth), FACTS)
    return [one.what for one in found.findings if one.what.startswith("contradicted")]


def staircase(force_n, at_us):
    """A run with commands alone: a tick each millisecond."""
    ticks = np.arange(force_n.size)
    torque = np.zeros(4 * force_n.size)
    return PerturbationRun(
        1000.0 * ticks, 0.0 * ticks, force_n, -1.0 + 0.0 * ticks, at_us, 0.0, torque, torque
    )


@pytest.mark.parametrize(("lag_us", "smooth_us"), [(0.0, 0.0), (330.0, 0.0), (930.0, 800.0)])
def test_a_command_is_delayed_and_smoothed_exactly(lag_us, smooth_us):
    """Against sums over steps of 1 us."""
    force = np.random.default_rng(1).standard_normal(40)
    run = staircase(force, np.zeros(40))
    found = commanded(run, Clock(0.0, 1.0, 0.0, 0.0), lag_us, smooth_us**2)
    time = np.arange(40_000) + 0.5 - (lag_us - smooth_us)
    held = force[np.clip(np.floor(time / 1000.0), 0, 39).astype(int)]
    smooth = np.empty(held.size)
    level = force[0]
    keep = np.exp(-1.0 / smooth_us) if smooth_us else 0.0
    for n, target in enumerate(held):
        # mean over the step of an exponential approach
        after = target + (level - target) * keep
        smooth[n] = target + (level - target) * smooth_us * (1.0 - keep) if smooth_us else target
        level = after
    triangle = np.concatenate((np.arange(250) + 0.5, 249.5 - np.arange(250))) / 250.0**2
    means = np.correlate(smooth, triangle, "valid")[::250]
    np.testing.assert_allclose(found[8:150], means[8:150], atol=2e-6)


@pytest.mark.parametrize("push_n", [-0.04, -0.01, 0.0, 0.03])
def test_friction_that_holds_is_as_much_as_pushes(push_n):
    handle = Handle(0.01, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0)
    found = friction(np.full(5, push_n), np.zeros(5), handle)
    np.testing.assert_allclose(found, push_n / 0.05, atol=1e-12)


def test_friction_turns_where_the_velocity_does():
    """From -2 mm/s with 20 m/s^2 more than friction: at rest after a fifth of the interval."""
    handle = Handle(0.01, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0)
    push = np.full(5, 0.35)
    slope = (0.35 + 0.05) / 0.01
    before = -0.002 + slope * 250e-6 * (np.arange(5) - 2)
    mean = before + 0.5 * slope * 250e-6
    stop = 0.002 / slope
    rest = 250e-6 - stop
    mean[2] = (-0.5 * 0.002 * stop + 0.5 * (0.3 / 0.01) * rest**2) / 250e-6
    found = friction(push, mean, handle)
    assert found[1] == -1.0
    assert found[2] == pytest.approx(1.0 - 2.0 * stop / 250e-6, abs=0.05)


def test_the_probes_clock_is_found_by_the_motion():
    run = shaken(Truth(), noise(8.0, 0.7, 1), 20.0, 0.3, 0)
    late = PerturbationRun(run.board_us + 90.0, *list(vars(run).values())[1:])
    found = clocked(late)
    assert found.phase_us == pytest.approx(90.0, abs=0.5)
    assert found.gain == pytest.approx(1.0, abs=2e-3)


def test_nothing_moves_is_said():
    still = staircase(np.zeros(12_000), np.zeros(12_000))
    with pytest.raises(AnalysisError, match="nothing moved"):
        fit_rigid_mass([still])


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


def test_a_balance_that_has_not_settled_is_refused(monkeypatch):
    monkeypatch.setattr(balance, "FIRST_ROUNDS", 1)
    monkeypatch.setattr(balance, "ROUNDS", 1)
    result = analyse(runs_of(Truth()), FACTS)
    assert not result.settled
    assert not result.values
    assert not result.changes
    assert "not settled" in result.findings[0].what


def test_a_mass_that_no_force_could_move_is_refused(monkeypatch):
    found = fit_rigid_mass(runs_of(Truth()))
    assert found.handle.mass_kg <= found.most_kg <= 3.0 * found.handle.mass_kg
    heavy = replace(found, handle=replace(found.handle, mass_kg=0.36), tests=())
    monkeypatch.setattr(identify, "_solved", lambda _: heavy)
    result = analyse(runs_of(Truth()), FACTS)
    assert not result.changes
    assert "moving mass 360 g" in result.findings[0].what
