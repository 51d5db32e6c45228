"""Every environment called passive and stable stays stable in 1,000 random passive hands (Colgate
and Hogan 1988).

Not pair by pair: 1,701 environments in 1,000 hands are a minute of eigenvalues (made once,
ADR-0017). Instead, as `model.coupled` says, a circle at each angle that no hand leaves (all
1,000 are tried, by the exact pulse transfer of device and hand), and which no called environment's
-1/C enters (all are tried). Eigenvalues then check that this is so: of environments at the edge in
all hands, and of random pairs, inside and outside. And it can fail: 5 % outside a hand shakes the
display.
"""

import numpy as np
import pytest
from support.analysis_devices import rigid
from support.coupled_hands import LEVEL, ROUNDING, called, hands

from examples.weir2008.paper import ADDED_NS_PER_M, LEVELS, MAIN
from examples.weir2008.run import POINTS, SCENES, conditions
from hapticd.model.coupled import (
    coupled_radius,
    coupled_stable,
    destabilising_hand,
    held_by,
    reach,
)
from hapticd.model.linearise import Perturbation
from hapticd.model.loop import PAPER_FILTERS, port_states, pulse_transfer, spectral_radius
from hapticd.model.predict import predict, with_equivalent_damping
from hapticd.model.theorem import lifted_passive, lifted_system

DEVICES = [
    (name, level)
    for name in SCENES
    for level in LEVELS
    if (name, level) != ("weir2008_literal", 0.0)
]


@pytest.mark.parametrize(("name", "level"), DEVICES)
def test_no_hand_leaves_its_circle(name, level):
    """1,000 hands at all angles; some come to the rim, so the circle is no larger than it must
    be.
    """
    device = conditions(name).display
    lifted = lifted_system(device.model, level, device.filters)
    turn = np.exp(1j * lifted.angles)
    centre, radius = reach(lifted)
    most = 0.0
    for hand in hands() if name == MAIN else hands()[:200]:
        out = np.abs(pulse_transfer(held_by(device.model, hand), turn, level) - centre) / radius
        assert out.max() <= 1.0 + 1e-6
        most = max(most, out[lifted.angles > 0.1].max())
    assert most > 0.99


@LEVEL
def test_called_environments_stay_stable_in_every_hand(level):
    """Eigenvalues of the whole loop: ten environments at the edge in all 1,000 hands, and ten
    random ones in each.
    """
    model, filters, lifted, points = called(MAIN, level)
    random = np.random.default_rng(7)
    edge = points[~lifted_passive(lifted, 1.1 * points)]
    nearest = edge[random.permutation(len(edge))[:10]]
    assert len(nearest) > 3
    for hand in hands():
        some = np.vstack((nearest, points[random.integers(len(points), size=10)]))
        assert coupled_radius(model, some, [hand], level, filters).max() < 1.0 + ROUNDING


def boundary(lifted, direction):
    """Factor of `direction` at which nothing is left to spare."""
    low = 0.0
    high = 1.0
    while lifted_passive(lifted, [high * direction])[0]:
        low = high
        high = 2.0 * high
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if lifted_passive(lifted, [middle * direction])[0] else (low, middle)
        )
    return low


EDGES = [
    ("rigid", 0.0),
    ("rigid late", 0.0),
    (MAIN, 0.0),
    (MAIN, ADDED_NS_PER_M),
    ("weir2008_probe_hp", ADDED_NS_PER_M),
]


@pytest.mark.parametrize(("name", "level"), EDGES)
def test_five_percent_outside_a_hand_shakes_it(name, level):
    """The requirement is necessary: for every direction in K, B, M a passive hand destabilises the
    point beyond the boundary, and the same hand does not 5 % inside.
    """
    own = {"rigid": (rigid(), PAPER_FILTERS), "rigid late": (rigid(delay=0.5), PAPER_FILTERS)}
    model, filters = (
        own[name]
        if name in own
        else (conditions(name).display.model, conditions(name).display.filters)
    )
    lifted = lifted_system(model, level, filters)
    random = np.random.default_rng(5)
    for _ in range(12):
        direction = random.normal(0.0, (500.0, 3.0, 0.01))
        direction[0] = abs(direction[0])
        edge = boundary(lifted, direction) * direction
        assert destabilising_hand(model, 0.95 * edge, level, filters) is None
        found = destabilising_hand(model, 1.05 * edge, level, filters)
        assert found is not None
        inside, outside = coupled_radius(
            model, [0.95 * edge, 1.05 * edge], [found[0]], level, filters
        )[0]
        assert inside < 1.0 + ROUNDING
        assert outside > 1.0 + 100.0 * ROUNDING


@pytest.mark.parametrize(
    ("name", "level", "share", "margin"),
    [
        (MAIN, 0.0, 0.0, 0.0),
        (MAIN, ADDED_NS_PER_M, 0.002, 0.02),
        ("weir2008_probe_hp", 0.0, 0.01, 0.02),
        ("weir2008_probe_hp", ADDED_NS_PER_M, 0.01, 0.02),
        ("weir2008_literal", ADDED_NS_PER_M, 0.1, 0.1),
    ],
)
def test_few_predictions_are_open_to_hands_and_with_little_margin(name, level, share, margin):
    """`predict`, friction linearised, sees the first harmonic, from 2 Hz on: no exception but for
    at most this share of its passive environments, with a margin below this share of the damping.
    They are real: a hand is at hand that shakes them, but for a few that lack 1 % or less, and
    would take more images than it is tuned for.
    """
    device = conditions(name).display
    found = predict(device.model, POINTS, level, device.filters, Perturbation())
    lifted = lifted_system(device.model, level, device.filters)
    passive = np.flatnonzero(found.passive)
    friction = found.friction_ns_per_m
    exceptions = passive[~coupled_stable(lifted, POINTS[passive], friction[passive])]
    assert len(exceptions) <= share * len(passive)
    shaken = 0
    for place in exceptions:
        assert found.margin_ns_per_m[place] < margin * (lifted.resistance.min() + friction[place])
        hand, at_hz = destabilising_hand(
            device.model, POINTS[place], level, device.filters, friction[place]
        )
        rubbed = with_equivalent_damping(
            device.model, np.full(len(port_states(device.model)), friction[place])
        )
        shaken += bool(
            coupled_radius(rubbed, [POINTS[place]], [hand], level, device.filters)[0, 0]
            > 1.0 + ROUNDING
        )
        if name == MAIN:
            assert at_hz < found.band_hz[0]
            assert hand.mass_kg[0] > 8.0
    assert shaken >= (1.0 if name == MAIN else 0.85) * len(exceptions)


@pytest.mark.parametrize(
    ("name", "level", "count"),
    [
        (MAIN, 0.0, 20),
        (MAIN, 1.74, 1500),
        ("weir2008_probe_hp", 1.74, 800),
        ("weir2008_literal", 1.74, 500),
    ],
)
def test_no_called_environment_enters_it(name, level, count):
    """By the lifted requirement, which safety decides on: all of them, no exception."""
    _, _, lifted, points = called(name, level)
    assert len(points) > count
    assert coupled_stable(lifted, points).all()


def test_whatever_a_hand_shakes_was_not_called():
    """Ten times the set: many pairs are unstable only because of the hand, and none of them was
    said to withstand it.
    """
    device = conditions(MAIN).display
    random = np.random.default_rng(8)
    points = random.uniform((0.0, -1.0, -0.03), (3000.0, 12.0, 0.05), (60, 3))
    points = points[spectral_radius(device.model, points, ADDED_NS_PER_M, device.filters) < 1.0]
    holds = coupled_stable(lifted_system(device.model, ADDED_NS_PER_M, device.filters), points)
    shaken = (
        coupled_radius(device.model, points, hands()[:150], ADDED_NS_PER_M, device.filters)
        > 1.0 + ROUNDING
    )
    assert shaken.sum() > 100
    assert not shaken[:, holds].any()


def test_random_hands_are_positive_real():
    """The definition: Re Z(s) >= 0 for every s in the right half-plane, not by the network's
    matrices but by Z itself.
    """
    random = np.random.default_rng(0)
    angle = random.uniform(-0.5, 0.5, 60) * np.pi
    size = 10.0 ** random.uniform(-1, 5, 60)
    for hand in hands():
        z = hand.impedance(size * np.exp(1j * angle))
        assert (z.real >= -ROUNDING * np.abs(z)).all()
