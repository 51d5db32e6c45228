"""The prediction: stability and margin together, a simulation of the true law, what is refused."""

import re

import numpy as np
import pytest
from support.analysis_devices import display

from hapticd.core.errors import AnalysisError
from hapticd.model.effects import Multiplier, PassiveHand, WindingTemperature
from hapticd.model.linearise import Perturbation
from hapticd.model.loop import spectral_radius
from hapticd.model.predict import predict, predicted_impedance
from hapticd.zwidth.passive_set import axis_limit

F = np.array([0.5, 2.0, 10.0, 47.0, 120.0, 333.0, 499.0, 700.0, 1500.0])
T = 1e-3
WHITE = Perturbation(2.5e-5, 1700.0)


def test_negative_stiffness_is_refused_unless_allowed():
    """Re Z > 0 all over the band, and unstable: 132 of 1,599 random environments are like this."""
    point = [[-34.0, -0.86, 0.0048]]
    found = predict(display(), point, 1.74, perturbation=WHITE)
    assert found.margin_ns_per_m[0] > 0.0
    assert found.refused[0]
    assert not found.passive[0]
    allowed = predict(display(), point, 1.74, perturbation=WHITE, allow_negative_stiffness=True)
    assert allowed.margin_ns_per_m[0] > 0.0
    assert allowed.spectral_radius[0] > 1.0
    assert not allowed.passive[0]


def test_some_passive_looking_environments_are_unstable():
    points = np.random.default_rng(4).uniform((-60, -2, -0.01), (300, 6, 0.02), (1500, 3))
    found = predict(display(), points, 1.74, perturbation=WHITE, allow_negative_stiffness=True)
    looks = found.margin_ns_per_m >= 0.0
    assert 0 < (looks & (found.spectral_radius >= 1.0)).sum() < looks.sum()
    assert not (found.passive & ~(found.spectral_radius < 1.0)).any()


def test_many_points_are_judged_as_each_alone():
    points = np.random.default_rng(2).uniform((0, -1, -0.01), (200, 3, 0.02), (1100, 3))
    together = predict(display(), points, perturbation=WHITE)
    for index in (0, 500, 1023, 1024, 1099):
        alone = predict(display(), points[index : index + 1], perturbation=WHITE)
        assert alone.passive[0] == together.passive[index]
        assert alone.margin_ns_per_m[0] == pytest.approx(together.margin_ns_per_m[index], rel=1e-9)
        assert alone.friction_ns_per_m[0] == pytest.approx(
            together.friction_ns_per_m[index], rel=1e-9
        )


def test_margin_is_the_least_real_part_of_the_impedance():
    point = (50.0, 2.0, 0.0)
    found = predict(display(), [point], perturbation=WHITE)
    band = np.linspace(2.0, 500.0, 9961)
    z = predicted_impedance(display(), point, band, perturbation=WHITE)
    assert found.margin_ns_per_m[0] == pytest.approx(z.real.min(), abs=2e-3)
    assert found.worst_hz[0] == pytest.approx(band[np.argmin(z.real)], abs=0.5)
    assert found.margin_deg[0] == pytest.approx(
        90 - np.degrees(np.abs(np.angle(z))).max(), abs=0.02
    )
    assert (band[0], band[-1]) == (2.0, 500.0)


def test_device_that_friction_no_longer_holds_is_not_passive():
    """Above the stiffness that viscous friction carries alone, a burst escapes although the
    calm solution has Re Z > 0.
    """
    found = predict(display(), [[90.0, 0, 0], [125.0, 0, 0]], perturbation=WHITE)
    assert list(found.calm) == [True, False]
    assert list(found.passive) == [True, False]
    assert (found.margin_ns_per_m > 0.0).all()


@pytest.mark.parametrize(("level", "reach"), [(0.0, 300.0), (1.74, 1500.0)])
def test_stiffness_axis_fails_once_and_for_good(level, reach):
    points = np.column_stack((np.linspace(0.0, reach, 300), np.zeros((300, 2))))
    passive = predict(display(), points, level, perturbation=WHITE).passive
    assert 0 < passive.sum() < 300
    assert np.array_equal(passive, np.arange(300) < passive.sum())


def calibrated(damping):
    """The calibrated display: 5.4 % of the winding's resistance uncompensated, multiplier
    trimmed for 1.74 N s/m.
    """
    trim = [
        Multiplier(gain_error=1 / 0.945 - 1),
        WindingTemperature(temperature_c=33.45, compensated_c=20.0),
    ]
    model = display(extra=trim)
    return lambda points: predict(model, points, damping, perturbation=WHITE).passive


@pytest.mark.parametrize(
    ("damping", "axis", "reach", "paper"),
    [
        (0.0, 0, 400, 100),
        (0.0, 1, 8, 3),
        (0.0, 2, -0.02, -0.008),
        (1.74, 0, 1500, 600),
        (1.74, 1, 15, 8),
        (1.74, 2, -0.05, -0.022),
    ],
)
def test_six_limits_are_near_the_paper(damping, axis, reach, paper):
    """Linearised friction is good to 17 % of the six axis limits of Weir 2008, section 5; the
    simulation comes nearer.
    """
    assert axis_limit(calibrated(damping), axis, reach) == pytest.approx(paper, rel=0.17)


def test_added_damping_adds_to_the_low_end():
    gained = predicted_impedance(display(), (0, 0, 0), F[1:3], 1.74) - predicted_impedance(
        display(), (0, 0, 0), F[1:3], 0.0
    )
    assert gained.real == pytest.approx(1.74, rel=1e-3)


def test_passive_hand_does_not_make_a_passive_loop_unstable():
    """Coupled stability: what is called passive stays stable in the hand (Colgate and Hogan
    1988).
    """
    random = np.random.default_rng(3)
    points = random.uniform((0, 0, -0.004), (80, 2.5, 0.01), (60, 3))
    passive = points[predict(display(coulomb=0.0, viscous=1.5), points).passive]
    assert len(passive) > 20
    for _ in range(20):
        m, b, k, grip_k, grip_b = random.uniform(
            (0.001, 0.2, 5, 200, 0.5), (0.05, 4, 300, 5000, 10)
        )
        hand = PassiveHand(
            mass_kg=m,
            damping_ns_per_m=b,
            stiffness_n_per_m=k,
            grip_stiffness_n_per_m=grip_k,
            grip_damping_ns_per_m=grip_b,
        )
        assert (
            spectral_radius(display(coulomb=0.0, viscous=1.5, extra=[hand]), passive) < 1.0
        ).all()


@pytest.mark.parametrize("points", [[[1.0, 2.0]], [1.0, 2.0, 3.0], [[np.inf, 0.0, 0.0]]])
def test_environments_must_be_finite_triples(points):
    message = "rows of three finite numbers K [N/m], B [N s/m], M [kg] are needed"
    with pytest.raises(AnalysisError, match=re.escape(message)):
        predict(display(), points)


def test_empty_list_is_judged_empty():
    assert predict(display(), np.empty((0, 3)), perturbation=WHITE).passive.size == 0
