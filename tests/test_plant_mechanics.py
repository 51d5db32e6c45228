"""The exact response against 60-digit decimals, for any damping, and the balance of work."""

from decimal import Decimal, getcontext

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapticd.plant.mechanics import held_force_response, phi1, phi2

MASS_KG = 0.008
DAMPINGS = (0.0, 1e-15, 1e-9, 1e-4, 0.36, 2.1, 10.36, 127.9, 128.1, 1e4)
DURATIONS_S = (1e-3 / 16, 250e-6, 1e-3, 62.5e-3, 1.0)


def decimal_phis(a: float) -> tuple[Decimal, Decimal]:
    """phi1 and phi2 by their series, term by term in 60 digits (or closed where the series is long)."""
    getcontext().prec = 60
    x = Decimal(a)
    if abs(x) > 5:
        first = (1 - (-x).exp()) / x
        return first, (1 - first) / x
    first = second = Decimal(0)
    term = Decimal(1)  # (-x)^k / (k + 1)!
    for k in range(80):
        first += term
        second += term / (k + 2)
        term *= -x / (k + 2)
    return first, second


@pytest.mark.parametrize("duration_s", DURATIONS_S)
@pytest.mark.parametrize("damping_ns_per_m", DAMPINGS)
def test_response_agrees_with_decimals(damping_ns_per_m, duration_s):
    a = damping_ns_per_m * duration_s / MASS_KG
    first, second = decimal_phis(a)
    m, h = Decimal(MASS_KG), Decimal(duration_s)
    expected = ((-Decimal(a)).exp(), h / m * first, h * first, h * h / m * second)
    found = held_force_response(MASS_KG, damping_ns_per_m, duration_s)
    assert found == pytest.approx([float(value) for value in expected], rel=4e-16 * max(1.0, a), abs=0.0)


def test_no_damping_is_exactly_ballistic():
    assert held_force_response(2.0, 0.0, 0.5) == (1.0, 0.25, 0.5, 0.0625)


def test_phis_are_smooth_where_the_form_changes():
    below, above = 1.0 - 2.0**-53, 1.0
    assert phi2(below) == pytest.approx(phi2(above), rel=1e-15)
    assert (phi1(0.0), phi2(0.0)) == (1.0, 0.5)


@pytest.mark.parametrize("pieces", [2, 3, 16, 1000])
def test_pieces_compose_to_the_whole(pieces):
    decay, gain, reach, push = held_force_response(MASS_KG, 0.36, 0.004 / pieces)
    x, v, force_n = 0.001, 0.3, -1.5
    for _ in range(pieces):
        x, v = x + reach * v + push * force_n, decay * v + gain * force_n
    decay, gain, reach, push = held_force_response(MASS_KG, 0.36, 0.004)
    assert (x, v) == pytest.approx((0.001 + reach * 0.3 + push * force_n, decay * 0.3 + gain * force_n), rel=1e-13)


def dissipated_j(damping: float, duration_s: float, v: float, force_n: float) -> float:
    """c times the integral of v(t)^2 with v(t) = vt + (v - vt) e^-rt, vt = f/c, r = c/m; in 60 digits."""
    getcontext().prec = 60
    c, h, f, m = Decimal(damping), Decimal(duration_s), Decimal(force_n), Decimal(MASS_KG)
    terminal, rate = f / c, c / m
    excess, once, twice = Decimal(v) - terminal, 1 - (-rate * h).exp(), 1 - (-2 * rate * h).exp()
    return float(c * (terminal * terminal * h + 2 * terminal * excess * once / rate + excess * excess * twice / (2 * rate)))


@settings(derandomize=True, max_examples=300)
@given(
    damping=st.floats(1e-3, 50.0), duration_s=st.floats(1e-5, 0.05), v=st.floats(-3.0, 3.0), force_n=st.floats(-10.0, 10.0)
)  # fmt: skip
def test_work_is_kinetic_plus_dissipated(damping, duration_s, v, force_n):
    decay, gain, reach, push = held_force_response(MASS_KG, damping, duration_s)
    distance, after = reach * v + push * force_n, decay * v + gain * force_n
    work, kinetic = force_n * distance, 0.5 * MASS_KG * (after * after - v * v)
    lost = dissipated_j(damping, duration_s, v, force_n)
    turnover = abs(force_n) * (abs(reach * v) + push * abs(force_n)) + 0.5 * MASS_KG * (after * after + v * v) + lost
    assert work == pytest.approx(kinetic + lost, rel=0.0, abs=1e-12 * turnover + 1e-300)
