"""The tick law against scipy, against numba bit by bit, and against closed forms."""

import math

import numpy as np
import pytest
from scipy import signal
from support.models import environment_tuple

from hapticd.core.environment import Environment, FilterParams, WallParams, WorkspaceParams
from hapticd.render import law
from hapticd.render.law import at_rest, design_coefficients, render

RATE_HZ = 1000.0
BUTTERWORTH = design_coefficients(FilterParams(100.0), FilterParams(72.0), RATE_HZ)


def fly(positions, params, limit_n=1e9, coefficients=BUTTERWORTH):
    """Forces and velocities of the law over `positions`, from rest at the first."""
    state = at_rest(positions[0])
    numbers = environment_tuple(params, limit_n)
    out = []
    for x in positions:
        force, _, v, a, *_, state = render(x, state, numbers, coefficients)
        out.append((force, v, a))
    return np.array(out).T


def reference(positions, params):
    """K on raw position, B and M on differences through scipy's own filters."""
    x = np.asarray(positions)
    padded = np.concatenate(([x[0], x[0]], x))
    velocity = np.diff(padded)[1:] * RATE_HZ
    acceleration = np.diff(padded, 2) * RATE_HZ**2
    first = signal.butter(2, 100.0, fs=RATE_HZ)
    second = signal.butter(2, 72.0, fs=RATE_HZ)
    v = signal.lfilter(*first, velocity)
    a = signal.lfilter(*second, acceleration)
    return (
        -(params.stiffness_n_per_m * x + params.virtual_damping_ns_per_m * v + params.mass_kg * a),
        v,
        a,
    )


@pytest.mark.parametrize(
    ("k", "b", "m"), [(100.0, 1.0, 0.010), (50.0, 2.0, 0.0), (600.0, 8.0, -0.022), (0.0, 0.0, 0.0)]
)
def test_force_equals_scipy_reference(k, b, m):
    rng = np.random.default_rng(1)
    positions = 1e-3 + np.cumsum(rng.integers(-40, 41, 20_000)) * 0.5e-6
    params = Environment(k, b, m)
    force, v, a = fly(positions.tolist(), params)
    expected, v_expected, a_expected = reference(positions, params)
    for ours, theirs in ((force, expected), (v, v_expected), (a, a_expected)):
        scale = max(np.abs(theirs).max(), 1.0)
        assert np.abs(ours - theirs).max() <= 1e-12 * scale


def test_constant_speed_gives_exact_damping_force():
    params = Environment(virtual_damping_ns_per_m=2.0)
    force, v, a = fly([1e-5 * n for n in range(2000)], params)
    assert v[-1] == pytest.approx(0.01, rel=1e-12)
    assert force[-1] == pytest.approx(-0.02, rel=1e-12)
    assert abs(a[-1]) < 1e-9


def test_constant_acceleration_gives_exact_inertia_force():
    params = Environment(mass_kg=0.01)
    force, _, _ = fly([0.5 * 3.0 * (n / RATE_HZ) ** 2 for n in range(3000)], params)
    assert force[-1] == pytest.approx(-0.03, rel=1e-6)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_force_is_finite_whatever_the_position(bad):
    numbers = environment_tuple(Environment(100.0, 1.0, 0.01), 8.0)
    force = render(bad, at_rest(0.0), numbers, BUTTERWORTH)[0]
    assert -8.0 <= force <= 8.0


@pytest.mark.parametrize(
    "force", [8.0, -8.0, 8.000001, -8.000001, 1e300, -1e300, math.inf, -math.inf]
)
def test_clamp_holds_at_its_boundary(force):
    assert law.clamp(force, 8.0) == math.copysign(8.0, force)
    assert law.clamp(math.nan, 8.0) == 0.0
    assert law.clamp(7.999999, 8.0) == 7.999999


def test_wall_pushes_only_outwards_and_only_inside():
    wall = (1000.0, 20.0, 0.001, 1.0)
    assert law.wall_force(0.0009, 1.0, *wall) == 0.0
    assert law.wall_force(0.0015, 0.0, *wall) == pytest.approx(-0.5)
    assert law.wall_force(0.0015, 0.01, *wall) == pytest.approx(-0.7)
    assert law.wall_force(0.0015, -1.0, *wall) == 0.0  # leaving fast: it never pulls
    assert law.wall_force(-0.0015, 0.0, 1000.0, 20.0, -0.001, -1.0) == pytest.approx(0.5)


def test_workspace_ends_are_soft_and_symmetric():
    params = Environment(workspace=WorkspaceParams(-0.01, 0.01, 500.0))
    numbers = environment_tuple(params, 8.0)
    inside, right, left = (
        render(x, at_rest(x), numbers, BUTTERWORTH)[0] for x in (0.005, 0.012, -0.012)
    )
    assert inside == 0.0
    assert right == pytest.approx(-1.0)
    assert left == pytest.approx(1.0)


def test_wall_field_adds_to_the_environment():
    params = Environment(stiffness_n_per_m=100.0, wall=WallParams(1000.0, 0.0, 0.001, 1))
    result = render(0.002, at_rest(0.002), environment_tuple(params, 8.0), BUTTERWORTH)
    assert result[0] == pytest.approx(-0.2 - 1.0)
    assert result[7] == pytest.approx(-1.0)
