"""Colgate and Schenkel: closed forms, delays, and the lifted theorem for a composed device."""

import numpy as np
import pytest
from support.analysis_devices import display, rigid

from hapticd.core.errors import AnalysisError
from hapticd.model.theorem import (
    lifted_margin,
    lifted_passive,
    lifted_system,
    required_damping,
)

PLAIN = (None, None)
T = 1e-3


def needed(point, **options):
    level, at = required_damping([point], filters=PLAIN, **options)
    return level[0], at[0]


@pytest.mark.parametrize("rate_hz", [500.0, 1000.0, 4000.0])
def test_spring_needs_half_a_period_of_itself(rate_hz):
    assert needed((300.0, 0.0, 0.0), rate_hz=rate_hz)[0] == pytest.approx(
        300.0 / (2 * rate_hz), rel=1e-9
    )


@pytest.mark.parametrize(("damping", "worst_hz"), [(2.0, 500.0), (-2.0, 0.16)])
def test_damper_needs_its_magnitude(damping, worst_hz):
    level, at = needed((400.0, damping, 0.0))
    assert level == pytest.approx(400.0 * T / 2 + 2.0, rel=1e-5)
    assert at == pytest.approx(worst_hz, abs=0.1)


def test_virtual_mass_needs_two_of_itself_a_period():
    assert needed((0.0, 0.0, 0.01)) == (pytest.approx(2 * 0.01 / T, rel=1e-9), pytest.approx(500.0))


def test_negative_mass_needs_nine_eighths_at_a_quarter():
    level, at = needed((0.0, 0.0, -0.01))
    assert level == pytest.approx(1.125 * 0.01 / T, rel=1e-5)
    assert np.cos(2 * np.pi * at * T) == pytest.approx(0.25, abs=0.01)


def test_all_three_follow_the_formula():
    theta = np.linspace(0.01, np.pi, 4000)
    point = (250.0, 0.8, 0.004)
    formula = 250.0 * T / 2 - 0.8 * np.cos(theta) + 0.004 / T * (np.cos(2 * theta) - np.cos(theta))
    assert needed(point)[0] == pytest.approx(formula.max(), rel=1e-5)


@pytest.mark.parametrize(
    ("delay", "level", "at_hz"), [(0, 1.0500, 500.0), (1, 1.05125, 246.0), (2, 1.05381, 162.0)]
)
def test_whole_delays_of_spring_and_damper(delay, level, at_hz):
    found, at = needed((100.0, 1.0, 0.0), delay_periods=delay)
    assert found == pytest.approx(level, abs=1e-5)
    assert at == pytest.approx(at_hz, abs=1.0)


@pytest.mark.parametrize("delay", [0.0, 0.125, 0.5, 1.0, 2.0, 2.3])
def test_delayed_spring_needs_it_at_rest_at_least(delay):
    """K (T/2 + d T) at 0 Hz; a fraction of a tick, which no sampled law can undo, asks for a
    little more.
    """
    level, _ = needed((1000.0, 0.0, 0.0), delay_periods=delay)
    least = 1000.0 * T * (0.5 + delay)
    assert level >= least * (1 - 1e-5)
    assert level == pytest.approx(least, rel=1e-5 if delay == int(delay) else 0.07)


def sums(theta, delay, images=100_000):
    w = theta + 2 * np.pi * np.arange(-images, images + 1)
    return (1 / w**2).sum(), (np.exp(-1j * w * delay) / w**2).sum()


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0, 1.7])
def test_sum_over_images_is_linear_within_a_tick(delay):
    """The step from the theorem to fractional delays, against 200,000 terms; the tail is
    2/(images (2 pi)^2).
    """
    for theta in (0.3, 1.7, 3.0):
        whole, part = divmod(delay, 1.0)
        total, late = sums(theta, delay)
        closed = (0.5 / np.sin(theta / 2)) ** 2
        assert total == pytest.approx(closed, rel=1e-5)
        shifted = closed * np.exp(-1j * theta * whole) * ((1 - part) + part * np.exp(-1j * theta))
        assert late == pytest.approx(shifted, rel=1e-5)


def test_filtered_laws_need_what_was_computed_before():
    lifted = required_damping([[0, 1, 0], [0, 0, 1]])[0]
    baseband = required_damping([[0, 1, 0], [0, 0, 1]], baseband=True)[0]
    assert lifted == pytest.approx([0.479, 130.4], rel=2e-3)
    assert baseband == pytest.approx([0.458, 118.9], rel=2e-3)


def test_baseband_of_a_damper_follows_its_formula():
    """-2 B cos(a) (1 - cos(a)) / a^2: at Nyquist 4/pi^2 = 0.405 of what all inputs need."""
    angle = np.linspace(0.5, np.pi, 5000)
    formula = -2.0 * np.cos(angle) * (1.0 - np.cos(angle)) / angle**2
    assert formula[-1] == pytest.approx(0.405, abs=1e-3)
    assert needed((0.0, 1.0, 0.0), baseband=True)[0] == pytest.approx(formula.max(), rel=1e-5)


def test_empty_environment_needs_nothing():
    assert required_damping([[0, 0, 0]])[0] == pytest.approx([0.0])


POINTS = [[100, 1, 0], [500, 0, 0], [0, 2, 0], [0, 0, -0.01], [300, -1, 0.005]]


@pytest.mark.parametrize("delay", [0.0, 0.125, 0.5, 1.0, 1.7])
def test_composed_rigid_device_agrees_with_the_closed_form(delay):
    found = lifted_margin(lifted_system(rigid(viscous=2.0, delay=delay)), POINTS)
    assert found == pytest.approx(2.0 - required_damping(POINTS, delay_periods=delay)[0], abs=1e-3)


def test_lifted_yes_or_no_is_the_sign_of_the_margin():
    lifted = lifted_system(display(), 1.74)
    points = np.random.default_rng(1).uniform((0, -1, -0.02), (3000, 6, 0.02), (40, 3))
    margin = lifted_margin(lifted, points)
    assert (margin > 0).any()
    assert (margin < 0).any()
    assert np.array_equal(lifted_passive(lifted, points), margin >= 0)


def test_friction_does_not_count_for_safety():
    assert lifted_margin(lifted_system(display(coulomb=0.0)), POINTS) == pytest.approx(
        lifted_margin(lifted_system(display(coulomb=0.05)), POINTS)
    )


@pytest.mark.parametrize("points", [[1.0, 2.0, 3.0], [[1.0, 2.0]], [[1.0, 2.0, np.nan]]])
def test_environments_must_be_triples(points):
    with pytest.raises(AnalysisError, match="rows of three finite numbers K"):
        required_damping(points)


def test_negative_stiffness_does_not_satisfy_the_lifted_requirement():
    """Below 1 Hz it is active, where no list of frequencies looks."""
    points = [[-34.0, -0.86, 0.0048], [0.0, 0.0, 0.0]]
    assert lifted_passive(lifted_system(rigid()), points).tolist() == [False, True]


@pytest.mark.parametrize("viscous", [0.3, 10.0, 1e5])
def test_margin_without_a_law_is_the_damping_of_the_device(viscous: float) -> None:
    """However little is between the ends of the search, it ends."""
    lifted = lifted_system(rigid(viscous=viscous))
    assert lifted_margin(lifted, [(0.0, 0.0, 0.0)])[0] == pytest.approx(viscous)
