"""The theorem at all angles: what the nodes say of the sums between them, and of zeros."""

from dataclasses import replace

import numpy as np
import pytest
from support.guard_device import rigid
from support.narrow_modes import ClosedForm, Narrow, directions, drawn, edge
from support.passive_hands import GROUND, Network

from hapticd.core.environment import FilterParams
from hapticd.model import rational as subject
from hapticd.model.bases import Conditions, Theorem, line_ends, model_of
from hapticd.model.compose import compose
from hapticd.model.loop import PAPER_FILTERS
from hapticd.model.rational import positive_everywhere, rational
from hapticd.model.theorem import circles, lifted_system, open_loop
from hapticd.zwidth.sources import device_scene

LEAF = Narrow(0.0058, 0.002, 36.6, 0.0005, 1.54, 0.25)
SHARP = (FilterParams(8.6, 0.3), FilterParams(25.0))


def at_angles(model, filters, angles):
    """The circles of the sums themselves."""
    return circles(lifted_system(model, 0.0, filters, open_loop(model, 0.0, angles, 100)))


@pytest.mark.parametrize("filters", [PAPER_FILTERS, (None, None), SHARP, (SHARP[0], SHARP[0])])
@pytest.mark.parametrize("delay", [0.0, 0.6, 1.0, 2.6])
def test_a_dozen_values_are_all_there_is_to_know(filters, delay):
    """Between its nodes the condition is the sum over harmonics, to 1e-7 of its size."""
    model = drawn(3)._replace(delay_periods=delay).model()
    found = rational(model, 0.0, filters, 0.0)
    assert found is not None
    assert found.form.shape[1] <= 15
    angles = np.random.default_rng(1).uniform(0.01, 3.13, 50)
    values, _ = found.nodes.at(np.cos(angles), found.form[:, None])
    size = np.abs(found.form).max(axis=1)[:, None]
    sums = at_angles(model, filters, angles).form
    np.testing.assert_allclose(values / size, sums / size, atol=1e-7)


@pytest.mark.parametrize("seed", range(10))
def test_edges_are_those_of_a_closed_form_on_a_dense_grid(seed):
    device = drawn(seed)
    found = rational(device.model(), 0.0, PAPER_FILTERS, 0.0)
    form = ClosedForm(device)
    for direction in directions(seed, 2):
        true = edge(form.holds, direction)
        if 0.0 < true < np.inf:
            reached = edge(lambda points: positive_everywhere(found, points), direction)
            assert 1.0 - 2e-4 < reached / true < 1.0 + 1e-6


def springs():
    """Springs to the wall, at the probe."""
    hands = []
    for stiffness in np.geomspace(10.0, 2e4, 120):
        network = Network()
        network.join(0, GROUND, float(stiffness))
        hands.append(network.hand())
    return hands


def bowl(depth):
    """(c - 0.3)^2 + `depth` at the nodes of a function without poles, with its nodes."""
    angles = np.pi * (np.arange(5) + 0.5) / 5.0
    nodes = subject._Nodes(np.cos(angles), np.sin(angles) * (-1.0) ** np.arange(5))
    return nodes, ((nodes.cosine - 0.3) ** 2 + depth)[None]


@pytest.mark.parametrize(
    ("depth", "positive"), [(1e-6, True), (1e-9, False), (0.0, False), (-1e-9, False)]
)
def test_what_is_not_decided_is_not_positive(depth, positive):
    """A dip to within rounding of zero counts as one below it."""
    assert subject._no_zero(*bowl(depth))[0] == positive


def test_poles_that_are_missing_are_noticed_and_nothing_is_safe(monkeypatch):
    model = drawn(0).model()
    at = Conditions(0.0, PAPER_FILTERS, model.delay_periods, 0.0)
    point = np.array([[1.0, 0.0, 0.0]])
    assert Theorem(model).safe(point, at)[0]
    monkeypatch.setattr(subject, "_resistance_zeros", lambda *_: np.zeros(0, np.complex128))
    assert rational(model, 0.0, PAPER_FILTERS, 0.0) is None
    assert not Theorem(model).safe(point, at)[0]


def test_a_device_that_spares_less_at_high_frequencies_renders_nothing():
    model = model_of(rigid(0.5))
    assert rational(model, 0.0, PAPER_FILTERS, 0.499) is not None
    assert rational(model, 0.0, PAPER_FILTERS, 0.501) is None
    assert not positive_everywhere(None, np.zeros((1, 3)))[0]


def test_a_dip_of_the_resistance_is_found_without_a_grid():
    """Active damping through a slow circuit: the resistance is least at no frequency's end."""
    scene = device_scene("weir2008")
    model = compose(scene)
    least = float(open_loop(model, 1.74, np.linspace(0.01, 3.13, 300), 3).impedance.real.min())
    high = float(open_loop(model, 1.74, np.ones(1), 400).impedance.real[0, -1])
    assert least < high - 0.01
    assert subject._poles(model, 1.74, PAPER_FILTERS, least - 1e-4) is not None
    assert subject._poles(model, 1.74, PAPER_FILTERS, least + 1e-4) is None


@pytest.mark.parametrize("seed", range(20))
def test_what_lies_between_safe_points_is_safe(seed):
    """The command acts on the rotor: the set is convex, and a way needs its two ends only."""
    device = drawn(seed)
    found = rational(device.model(), 0.0, PAPER_FILTERS, 0.0)
    assert found.convex
    random = np.random.default_rng((5, seed))
    points = random.uniform((0.0, -1.0, -0.004), (600.0, 2.0, 0.006), (400, 3))
    points *= np.exp(random.uniform(np.log(0.01), 0.0, (400, 1)))
    safe = points[positive_everywhere(found, points)]
    assert len(safe) > 4
    pairs = random.integers(0, len(safe), (2, 200))
    assert positive_everywhere(found, 0.5 * safe[pairs[0]] + 0.5 * safe[pairs[1]]).all()


def test_a_command_that_acts_on_the_slider_too_leaves_no_convex_set():
    model = drawn(0).model()
    column = model.inputs.command
    b0 = model.b0.copy()
    rotor, slider = (
        next(n for n, state in enumerate(model.states) if state.name == f"{body}_velocity")
        for body in ("rotor", "slider")
    )
    b0[slider, column] = 0.5 * b0[rotor, column]
    found = rational(replace(model, b0=b0), 0.0, PAPER_FILTERS, 0.0)
    assert not found.convex


def test_a_way_has_its_two_ends_and_a_triangle_has_none():
    share = np.linspace(0.0, 1.0, 20)[:, None]
    way = np.array([[10.0, 0.5, 0.0]]) + share * np.array([[300.0, -0.2, 1e-3]])
    assert sorted(line_ends(way)) == [0, 19]
    shuffled = np.random.default_rng(1).permutation(20)
    assert sorted(line_ends(way[shuffled])) == sorted(np.flatnonzero(shuffled % 19 == 0))
    assert line_ends(np.eye(3)) is None
    way[7, 1] += 1e-9
    assert line_ends(way) is None
