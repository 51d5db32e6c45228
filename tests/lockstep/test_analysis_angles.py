"""Narrow modes: the theorem does not step over them, and says so where it cannot look."""

import numpy as np
import pytest
from support.guard_device import change, setup_of
from support.narrow_modes import ClosedForm, Narrow, drawn
from support.passive_hands import GROUND, Network

from hapticd.core.environment import Environment
from hapticd.core.params import EnvironmentLimits
from hapticd.guard.judge import Judge
from hapticd.guard.safe_region import SafeRegion, intervals
from hapticd.model.angles import angles_of, least_between, unresolved_hz
from hapticd.model.bases import Conditions, Theorem
from hapticd.model.coupled import coupled_radius
from hapticd.model.effects import Coupling, Masses, Motor, Viscous
from hapticd.model.loop import PAPER_FILTERS
from hapticd.model.theorem import Circles, outside_circles
from hapticd.settings.scene import model_params

LEAF = Narrow(0.0058, 0.002, 36.6, 0.01, 1.54, 0.25)


def conditions(device):
    return Conditions(0.0, PAPER_FILTERS, device.delay_periods, 0.0)


def springs():
    """Springs to the wall, at the probe."""
    hands = []
    for stiffness in np.geomspace(10.0, 2e4, 60):
        network = Network()
        network.join(0, GROUND, float(stiffness))
        hands.append(network.hand())
    return hands


def test_what_a_spring_shakes_is_not_called_safe():
    """Between angles 1 Hz apart the mode at 31 Hz went unseen, and K = 84 N/m was called safe."""
    point = (84.0, 0.0, 0.0)
    assert coupled_radius(LEAF.model(), [point], springs()).max() > 1.001
    theorem = Theorem(LEAF.model())
    assert not theorem.safe(np.array([point]), conditions(LEAF))[0]
    assert theorem.reading(point, conditions(LEAF)).margin_ns_per_m < 0.0


def test_margin_and_answer_agree_at_the_edge_of_a_narrow_mode():
    theorem = Theorem(LEAF.model())
    stiffness = np.linspace(60.0, 90.0, 301)
    points = np.column_stack((stiffness, np.zeros((301, 2))))
    last = points[int(np.argmin(theorem.safe(points, conditions(LEAF)))) - 1]
    assert 0.0 < theorem.reading(tuple(last), conditions(LEAF)).margin_ns_per_m < 0.01
    beyond = theorem.reading(tuple(1.005 * last), conditions(LEAF))
    assert beyond.margin_ns_per_m < 0.0
    assert beyond.worst_hz == pytest.approx(31.2, abs=0.5)


@pytest.mark.parametrize("mode_hz", [36.6, 180.0, 700.0, 1300.0])
def test_angles_are_dense_about_a_mode_wherever_it_folds_to(mode_hz):
    device = LEAF._replace(mode_hz=mode_hz, ratio=0.001)
    spring, damper = device.spring
    held = np.sqrt(spring / device.slider_kg) * 1e-3
    folded = abs(np.remainder(held + np.pi, 2.0 * np.pi) - np.pi)
    half_width = 0.5 * damper / device.slider_kg * 1e-3
    angles = angles_of(device.model())
    assert np.abs(angles - folded).min() < 0.2 * half_width
    near = np.abs(angles - folded) < 3.0 * half_width
    assert np.diff(angles[near]).max() < half_width


@pytest.mark.parametrize("seed", range(6))
def test_safe_agrees_with_a_closed_form_on_a_dense_grid(seed):
    device = drawn(seed)
    random = np.random.default_rng(seed)
    points = random.uniform((0.0, 0.0, -0.002), (600.0, 2.0, 0.004), (300, 3))
    points *= np.exp(random.uniform(np.log(0.01), 0.0, (300, 1)))
    form = ClosedForm(device)
    safe = Theorem(device.model()).hopeful(points, conditions(device))
    assert form.holds(0.999 * points)[safe].all()
    assert not (form.holds(points / 0.98) & ~safe).any()


def test_a_parabola_is_followed_to_its_vertex():
    angles = np.array([0.1, 0.13, 0.2, 0.24, 0.4])
    values = np.stack([3.0 * (angles - at) ** 2 - 0.5 for at in (0.15, 0.21, 0.3)])
    np.testing.assert_allclose(least_between(angles, values), -0.5, rtol=1e-12)


def test_circles_between_two_angles_count():
    """A form that is positive at its angles, with a vertex below 0 between two of them."""
    angles = np.array([0.1, 0.2, 0.3, 0.4])
    form = np.zeros((10, 4))
    form[0] = (angles - 0.26) ** 2 - 1e-4
    assert form[0].min() > 0.0
    assert not outside_circles(Circles(angles, form), np.zeros((1, 3)))[0]


def test_no_value_below_is_made_of_a_straight_line():
    angles = np.array([0.1, 0.2, 0.3, 0.5])
    values = np.array([[4.0, 3.0, 2.0, 0.0], [1.0, 1.0, 1.0, 1.0]])
    assert least_between(angles, values).tolist() == [0.0, 1.0]


def display(point):
    return Environment(*point, *PAPER_FILTERS)


@pytest.mark.parametrize("seed", range(40))
def test_an_axis_whose_own_value_is_safe_has_an_interval(seed):
    device = drawn(seed)
    judgement = SafeRegion(Theorem(device.model()), (device.delay_periods,), 0.0)
    random = np.random.default_rng((4, seed))
    points = random.uniform((0.0, -1.0, -0.004), (600.0, 2.0, 0.006), (60, 3))
    points *= np.exp(random.uniform(np.log(0.01), 0.0, (60, 1)))
    safe = [point for point in points if judgement.safe([display(point)])[0]]
    assert safe
    for point in safe[:6]:
        found = judgement.allowed(
            display(point), EnvironmentLimits((-1e4, -1e2, -1e1), (1e5, 1e3, 1e1))
        )
        for value, (name, interval) in zip(point, found.items(), strict=True):
            assert interval is not None, (name, point)
            assert interval[0] <= value <= interval[1], (name, point)


def test_an_interval_that_was_hoped_for_in_vain_is_sought_again():
    """All within 10 is hoped to be safe, and only what is below 2 is."""

    def safe(values, sure):
        return [(np.abs(one) < 10.0) & ((one < 2.0) | (not sure)) for one in values]

    (found,) = intervals(safe, [(-100.0, 100.0)], [1.0])
    assert found[0] == pytest.approx(-10.0, rel=0.01)
    assert found[1] == pytest.approx(2.0, rel=0.01)
    assert found[1] < 2.0


def lossless():
    """A device file's model whose mode has no damping at all."""
    effects = (
        Masses(rotor_kg=0.005, slider_kg=0.002),
        Motor(torque_constant_nm_per_a=1.0, lever_m=1.0, resistance_ohm=1.0),
        Coupling(stiffness_n_per_m=100.0, damping_ns_per_m=0.0),
        Viscous(rotor_ns_per_m=1.5),
    )
    return model_params("lossless", effects, 1000.0)


def test_a_mode_that_cannot_be_resolved_is_unknown_and_refused():
    judge = Judge(setup_of(lossless()))
    assert judge.theorem is not None
    hz = np.sqrt(100.0 / 0.002) / (2.0 * np.pi)
    assert unresolved_hz(judge.theorem.model, 0.0) == pytest.approx([hz], rel=1e-6)
    answer = change(judge, {"K": 10.0})
    assert answer["action"] == "refuse"
    assert answer["verdict"]["safe"] is None
    assert f"{hz:.4g} Hz" in answer["verdict"]["text"]
    assert change(judge, {"K": 10.0}, policy="warn")["verdict"]["safe"] is None


def test_a_mode_of_a_steel_leaf_spring_is_resolved():
    assert unresolved_hz(LEAF._replace(ratio=1e-3).model(), 0.0) == []
