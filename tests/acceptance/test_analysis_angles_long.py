"""Narrow modes, at length: edges on 300 devices against a closed form, and hands at these edges.

The theorem also holds for hands that change with time, such as a grip, so it refuses some
environments that no constant hand shakes. How far its edge lies inside that of constant hands is
measured here.
"""

import numpy as np
import pytest
from support.narrow_modes import ClosedForm, directions, drawn, edge
from support.passive_hands import GROUND, Network, random_hands

from hapticd.model.bases import Conditions, Theorem
from hapticd.model.coupled import coupled_radius, shaking_hand
from hapticd.model.loop import PAPER_FILTERS

DEVICES = 300
HANDS = random_hands(DEVICES)
ROUNDING = 1e-9  # of an eigenvalue of a mode without loss
SPRINGS = np.array([[600.0, 0.0, 0.0]])


def edges(seed, ways, constant=False):
    """The `ways` (n, 3) that end, with the edge by the guard's theorem and by the closed form, the
    theorem's or that of `constant` hands.
    """
    device = drawn(seed)
    theorem = Theorem(device.model())
    at = Conditions(0.0, PAPER_FILTERS, device.delay_periods, 0.0)
    form = ClosedForm(device, constant)
    for direction in ways:
        true = edge(form.holds, direction)
        if 0.0 < true < np.inf:
            yield direction, edge(lambda points: theorem.safe(points, at), direction), true


@pytest.mark.parametrize("block", range(10))
def test_edges_are_those_of_a_dense_grid_on_300_devices(block):
    """Modes of 20 to 400 Hz, ratios of 0.0005 to 0.1: no edge lies too far, and few too near."""
    seeds = range(block, DEVICES, 10)
    found = [edge / true for seed in seeds for _, edge, true in edges(seed, directions(seed, 2))]
    assert len(found) > 50
    assert max(found) < 1.0 + 1e-6
    assert np.median(found) > 0.9995
    assert np.quantile(found, 0.05) > 0.998


@pytest.mark.parametrize(
    ("ways", "middle", "low"),
    [(lambda _: SPRINGS, 0.975, 0.915), (lambda seed: directions(seed, 2), 0.977, 0.765)],
    ids=["springs", "any"],
)
def test_few_refusals_are_needless(ways, middle, low):
    """Median and 5 % quantile of the edge, over that of constant hands."""
    found = [
        edge / true
        for seed in range(0, DEVICES, 3)
        for _, edge, true in edges(seed, ways(seed), constant=True)
    ]
    assert len(found) > 50
    assert max(found) < 1.0 + 1e-6
    assert np.median(found) > middle
    assert np.quantile(found, 0.05) > low


def test_a_constant_hand_shakes_what_lies_beyond_the_edge_of_constant_hands():
    """By 0.3 %; so that edge is the true one."""
    for seed in range(0, DEVICES, 30):
        model = drawn(seed).model()
        for direction, _, true in edges(seed, directions(seed, 1), constant=True):
            beyond = 1.003 * true * direction
            assert shaking_hand(model, beyond, 0.0, PAPER_FILTERS) is not None


def single(stiffness, mass):
    """A spring to the wall and a mass on the probe."""
    network = Network(float(mass))
    network.join(0, GROUND, float(stiffness))
    return network.hand()


LOSSLESS = [single(k, m) for k in np.geomspace(1.0, 1e5, 12) for m in (0.0, 0.01, 1.0)]


def test_no_hand_shakes_an_environment_just_inside_an_edge():
    """Lossless springs and masses, and random networks, at 0.999 of an edge of each device; the
    same springs and masses do shake some environments at 1.1 of it.
    """
    shaken_beyond = 0
    for seed in range(0, DEVICES, 3):
        model = drawn(seed).model()
        for direction, reached, _ in edges(seed, directions(seed, 1)):
            points = np.array([0.999, 1.1])[:, None] * reached * direction
            inside, beyond = coupled_radius(model, points, LOSSLESS).T
            assert inside.max() < 1.0 + ROUNDING
            shaken_beyond += int(beyond.max() > 1.0 + ROUNDING)
            some = HANDS[seed : seed + 3]
            assert coupled_radius(model, points[:1], some).max() < 1.0 + ROUNDING
    assert shaken_beyond > 25
