"""The second opinion on stability, itself checked: closed forms of sampled loops, of composed
devices and of hands.
"""

import numpy as np
import pytest
from scipy.linalg import expm
from support.analysis_devices import display
from support.passive_hands import random_hands
from support.whole_tick import (
    Display,
    PlainHand,
    Point,
    eigenvalues,
    exponential,
    gripping,
    held_mass,
    low_pass,
    radius,
)

from hapticd.model.coupled import coupled_radius

T = 1e-3
MASS = 0.008
BARELY = 1e-3  # of a limit, to either side


def normalised(alpha=0.0, beta=0.0, mu=0.0, delta=0.0, delay=0.0):
    """Radius of alpha = K T^2 / m, beta = B T / m, mu = M / m, delta = b T / m, no filters."""
    display = Display(rotor_kg=MASS, rotor_ns_per_m=delta * MASS / T, delay_periods=delay)
    point = Point(alpha * MASS / T**2, beta * MASS / T, mu * MASS)
    return radius(display, [point], filtered=False)[0]


@pytest.mark.parametrize("beta", [0.1, 0.4, 2**1.5 - 2, 1.2, 1.8])
def test_mass_with_spring_and_damper_has_the_limit_of_jury(beta):
    """alpha = 2 beta (2 - beta) / (2 + beta) without delay and physical damping."""
    limit = 2 * beta * (2 - beta) / (2 + beta)
    assert normalised(alpha=limit * (1 - BARELY), beta=beta) < 1 - 1e-6
    assert normalised(alpha=limit * (1 + BARELY), beta=beta) > 1 + 1e-6


def test_stiffest_spring_of_all():
    """alpha = 4 (3 - 2 sqrt 2) = 0.6863 at beta = 2 sqrt 2 - 2 = 0.8284."""
    peak = 4 * (3 - 2 * 2**0.5)
    assert normalised(alpha=peak * (1 - BARELY), beta=2**1.5 - 2) < 1.0
    assert all(normalised(alpha=peak * (1 + BARELY), beta=b) > 1 for b in np.linspace(0.1, 2, 60))


def test_stiffest_spring_after_one_sample_of_delay():
    stable = [
        beta
        for beta in np.linspace(0.3, 0.55, 26)
        if normalised(alpha=0.1443, beta=beta, delay=1.0) < 1.0
    ]
    assert np.mean(stable) == pytest.approx(0.42, abs=0.01)
    assert all(
        normalised(alpha=0.1447, beta=b, delay=1.0) > 1.0 for b in np.linspace(0.02, 0.9, 89)
    )


@pytest.mark.parametrize(("delay", "limit"), [(0, 0.03967), (1, 0.01322), (2, 0.00792)])
def test_small_gains_follow_gil_and_hulin(delay, limit):
    """Near K < (b + B) / (T / 2 + t_d), and exactly what the z-plane says."""
    lightly = {"beta": 0.01, "delta": 0.01, "delay": delay}
    assert normalised(alpha=limit * 0.999, **lightly) < 1.0
    assert normalised(alpha=limit * 1.001, **lightly) > 1.0
    assert limit == pytest.approx(0.02 / (0.5 + delay), rel=0.011)


@pytest.mark.parametrize(
    ("mu", "delay", "stable"),
    [
        (1.99, 0, True),
        (2.01, 0, False),
        (-0.99, 0, True),
        (-1.01, 0, False),
        (5**0.5 - 1 - 0.01, 1, True),
        (5**0.5 - 1 + 0.01, 1, False),
    ],
)
def test_virtual_mass_alone_has_the_limits_of_its_polynomial(mu, delay, stable):
    """2 z^(d + 2) + mu (z + 1) = 0: -m < M < 2 m, with one sample of delay sqrt(5) - 1."""
    polynomial = np.zeros(delay + 3)
    polynomial[0] = 2.0
    polynomial[-2:] = mu
    other = np.abs(np.roots(polynomial)).max()
    found = normalised(mu=mu, delay=delay)
    assert bool(other < 1.0) is stable
    assert found == pytest.approx(max(1.0, other), abs=1e-6)


@pytest.mark.parametrize("delay", [0.0, 0.125, 0.3, 0.5, 0.99])
def test_delay_within_a_tick_is_the_modified_z_transform(delay):
    """z (z - 1)^2 + alpha/2 ((1 - d)^2 z^2 + (1 + 2 d - 2 d^2) z + d^2) for a free mass."""
    alpha = 0.3
    part = 0.5 * alpha * np.array([(1 - delay) ** 2, 1 + 2 * delay - 2 * delay**2, delay**2])
    expected = np.roots(np.array([1.0, -2.0, 1.0, 0.0]) + np.concatenate(([0.0], part)))
    display = Display(rotor_kg=MASS, rotor_ns_per_m=0.0, delay_periods=delay)
    found = eigenvalues(display, [Point(alpha * MASS / T**2, 0.0, 0.0)], filtered=False)[0]
    for root in expected:
        assert np.abs(found - root).min() < 1e-7


def poles(display, point, hand):
    """Continuous poles of a display without a law."""
    found = eigenvalues(display, [point], hand)[0]
    return np.log(found[np.abs(found) > 1e-4].astype(complex)) / T


def has(found, expected, rel=1e-6):
    return all(np.abs(found - one).min() < rel * (1.0 + abs(one)) for one in expected)


def test_hand_adds_to_the_roots_of_the_mass():
    rigid = Display(rotor_kg=MASS, rotor_ns_per_m=0.36, delay_periods=0.125)
    found = poles(rigid, Point(0, 0, 0, level=0.5), held_mass(0.012, 300.0, 0.2))
    assert has(found, np.roots([0.020, 0.36 + 0.5 + 0.2, 300.0]))


def test_gripping_hand_has_the_roots_of_two_masses():
    rigid = Display(rotor_kg=MASS, rotor_ns_per_m=0.36, delay_periods=0.125)
    found = poles(rigid, Point(0, 0, 0), gripping(0.05, 2000.0, 0.7))
    link = [0.7, 2000.0]
    both = np.polysub(
        np.polymul(np.polyadd([MASS, 0.36, 0.0], link), np.polyadd([0.05, 0.0, 0.0], link)),
        np.polymul(link, link),
    )
    assert has(found, [root for root in np.roots(both) if abs(root) > 1.0])


def test_node_without_a_mass_is_a_maxwell_arm():
    """Spring 400 N/m and damper 3 N s/m in a row: Z = 1 / (s / 400 + 1 / 3)."""
    between = np.array([[1.0, -1.0], [-1.0, 1.0]])
    arm = PlainHand(np.zeros(2), np.diag([0.0, 3.0]), 400.0 * between)
    rigid = Display(rotor_kg=MASS, rotor_ns_per_m=0.36, delay_periods=0.125)
    expected = np.roots(np.polyadd(np.polymul([MASS, 0.36], [1 / 400, 1 / 3]), [1.0]))
    assert has(poles(rigid, Point(0, 0, 0), arm), expected)


def test_damping_circuit_has_the_roots_of_its_loop():
    """(m s + b) ((s/w_a + 1) (s/w_e + 1) + g rho) + g = 0."""
    level, rho, wa, we = 1.74, 0.03, 2 * np.pi * 800.0, 2 * np.pi * 400.0
    display = Display(
        rotor_kg=MASS, rotor_ns_per_m=0.36, delay_periods=0.125,
        amplifier_hz=800.0, estimate_hz=400.0, level_gain=1.1, residual_m_per_s_n=rho,
    )  # fmt: skip
    gain = 1.1 * level
    lags = np.polyadd(np.polymul([1 / wa, 1.0], [1 / we, 1.0]), [gain * rho])
    expected = np.roots(np.polyadd(np.polymul([MASS, 0.36], lags), [gain]))
    found = poles(display, Point(0, 0, 0, level=level), held_mass(0.0))
    assert has(found, expected, rel=1e-5)


def test_coupling_has_its_mode():
    display = Display(
        rotor_kg=0.0055, rotor_ns_per_m=0.0, delay_periods=0.0, slider_kg=0.0025,
        coupling_n_per_m=4e4, coupling_ns_per_m=2.0,
    )  # fmt: skip
    reduced = 1 / (1 / 0.0055 + 1 / 0.0025)
    found = eigenvalues(display, [Point(0, 0, 0)])[0]
    assert has(found, np.exp(T * np.roots([reduced, 2.0, 4e4])))  # beyond half the rate


def test_smoothing_lets_a_slow_spring_be_active():
    """b > K (T/2 + d T + 1/w) at low frequencies: a heavy hand finds it."""
    corner = 31.8
    needed = 100.0 * (0.5 * T + 0.125 * T + 1 / (2 * np.pi * corner))
    heavy = held_mass(200.0)
    for share, stable in ((1.01, True), (0.99, False)):
        display = Display(
            rotor_kg=MASS, rotor_ns_per_m=share * needed, delay_periods=0.125, smoothing_hz=corner
        )
        found = radius(display, [Point(100.0, 0.0, 0.0)], heavy)[0]
        assert bool(found < 1.0) is stable


def test_exponential_is_scipys():
    random = np.random.default_rng(2)
    for size in 10.0 ** np.linspace(-9, -2, 8):
        matrices = size * random.normal(size=(5, 6, 6)) * np.geomspace(1.0, 1e4, 6)
        for found, one in zip(exponential(matrices), matrices, strict=True):
            assert np.linalg.norm(found - expm(one)) <= 1e-9 * np.linalg.norm(expm(one))


@pytest.mark.parametrize("mapping", ["prewarped", "bilinear", "matched"])
def test_filters_pass_a_steady_value_and_halve_the_power_at_their_corner(mapping):
    b0, b1, b2, a1, a2 = low_pass(100.0, 0.5**0.5, 1000.0, mapping)
    assert (b0 + b1 + b2) / (1 + a1 + a2) == pytest.approx(1.0)
    z = np.exp(2j * np.pi * 0.1)
    gain = abs((b0 * z * z + b1 * z + b2) / (z * z + a1 * z + a2))
    if mapping == "prewarped":
        assert gain == pytest.approx(0.5**0.5)
    assert gain == pytest.approx(0.5**0.5, rel=0.06)


def test_hand_of_300_g_shakes_500_n_per_m_where_damping_is_short():
    """The least damping of K = 500 N/m, B = 2 N s/m on 8 g and 0.36 N s/m is 0.957 N s/m."""
    shipped = Display(rotor_kg=0.008, rotor_ns_per_m=0.36, delay_periods=0.125)
    levels = [0.0, 0.9, 0.957, 1.74]
    found = radius(shipped, [Point(500.0, 2.0, 0.0, one) for one in levels], gripping(0.3, 3110.0))
    assert found[0] == pytest.approx(1.047, abs=1e-3)
    assert 1.0003 < found[1] < 1.001
    assert np.all(found[2:] < 1.0)


def test_package_and_second_opinion_agree_in_every_hand():
    points = np.random.default_rng(3).uniform((0, -2, -0.02), (2000, 6, 0.02), (8, 3))
    level = 1.2
    model = display(delay=1.3, coulomb=0.0)
    own = Display(
        rotor_kg=0.0055, slider_kg=0.0025, rotor_ns_per_m=0.6 * 0.358, slider_ns_per_m=0.4 * 0.358,
        coupling_n_per_m=4e4, coupling_ns_per_m=2.0, smoothing_hz=31.8, amplifier_hz=5e3,
        estimate_hz=1e3, delay_periods=1.3,
    )  # fmt: skip
    hands = random_hands(20)
    found = [radius(own, [Point(*one, level) for one in points], hand) for hand in hands]
    assert np.abs(found - coupled_radius(model, points, hands, level)).max() < 1e-10
