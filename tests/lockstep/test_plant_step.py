"""The rigid mass: its exact response against 60-digit decimals, the balance of work, and the
generated step: what it computes, what it leaves out, and that a traceback shows it.
"""

import traceback
from decimal import Decimal, getcontext
from math import inf, nan

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.boards import board_params

import hapticd.model.step as plant_step
from hapticd.core.errors import ConfigError
from hapticd.model.step import held_force_response, make_step, phi1, phi2, step_source

MASS_KG = 0.008
DAMPINGS = (0.0, 1e-15, 1e-9, 1e-4, 0.36, 2.1, 10.36, 127.9, 128.1, 1e4)
DURATIONS_S = (1e-3 / 16, 250e-6, 1e-3, 62.5e-3, 1.0)


def decimal_phis(a: float) -> tuple[Decimal, Decimal]:
    """phi1 and phi2 by their series, term by term in 60 digits (or closed where the series is
    long).
    """
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
    m = Decimal(MASS_KG)
    h = Decimal(duration_s)
    expected = ((-Decimal(a)).exp(), h / m * first, h * first, h * h / m * second)
    found = held_force_response(MASS_KG, damping_ns_per_m, duration_s)
    assert found == pytest.approx(
        [float(value) for value in expected], rel=4e-16 * max(1.0, a), abs=0.0
    )


def test_no_damping_is_exactly_ballistic():
    assert held_force_response(2.0, 0.0, 0.5) == (1.0, 0.25, 0.5, 0.0625)


def test_phis_are_smooth_where_the_form_changes():
    below = 1.0 - 2.0**-53
    above = 1.0
    assert phi2(below) == pytest.approx(phi2(above), rel=1e-15)
    assert (phi1(0.0), phi2(0.0)) == (1.0, 0.5)


@pytest.mark.parametrize("pieces", [2, 3, 16, 1000])
def test_pieces_compose_to_the_whole(pieces):
    decay, gain, reach, push = held_force_response(MASS_KG, 0.36, 0.004 / pieces)
    x = 0.001
    v = 0.3
    force_n = -1.5
    for _ in range(pieces):
        x = x + reach * v + push * force_n
        v = decay * v + gain * force_n
    decay, gain, reach, push = held_force_response(MASS_KG, 0.36, 0.004)
    assert (x, v) == pytest.approx(
        (0.001 + reach * 0.3 + push * force_n, decay * 0.3 + gain * force_n), rel=1e-13
    )


def dissipated_j(damping: float, duration_s: float, v: float, force_n: float) -> float:
    """c times the integral of v(t)^2 with v(t) = vt + (v - vt) e^-rt, vt = f/c, r = c/m; in 60
    digits.
    """
    getcontext().prec = 60
    c = Decimal(damping)
    h = Decimal(duration_s)
    f = Decimal(force_n)
    m = Decimal(MASS_KG)
    terminal = f / c
    rate = c / m
    excess = Decimal(v) - terminal
    once = 1 - (-rate * h).exp()
    twice = 1 - (-2 * rate * h).exp()
    return float(
        c
        * (
            terminal * terminal * h
            + 2 * terminal * excess * once / rate
            + excess * excess * twice / (2 * rate)
        )
    )


@settings(derandomize=True, max_examples=300)
@given(
    damping=st.floats(1e-3, 50.0),
    duration_s=st.floats(1e-5, 0.05),
    v=st.floats(-3.0, 3.0),
    force_n=st.floats(-10.0, 10.0),
)
def test_work_is_kinetic_plus_dissipated(damping, duration_s, v, force_n):
    decay, gain, reach, push = held_force_response(MASS_KG, damping, duration_s)
    distance = reach * v + push * force_n
    after = decay * v + gain * force_n
    work = force_n * distance
    kinetic = 0.5 * MASS_KG * (after * after - v * v)
    lost = dissipated_j(damping, duration_s, v, force_n)
    turnover = (
        abs(force_n) * (abs(reach * v) + push * abs(force_n))
        + 0.5 * MASS_KG * (after * after + v * v)
        + lost
    )
    assert work == pytest.approx(kinetic + lost, rel=0.0, abs=1e-12 * turnover + 1e-300)


STOPPED = board_params(lower_stop_m=-0.022, upper_stop_m=0.022)


@pytest.mark.parametrize(("damping", "substeps"), [(0.0, 4), (1.74, 4), (1.74, 2), (10.0, 320)])
def test_step_is_the_exact_response(damping, substeps):
    state = make_step(board_params())((0.001, -0.2), 1.5, -0.25, damping, substeps)
    decay, gain, reach, push = held_force_response(0.008, 0.36 + damping, substeps / 16000)
    assert state == (0.001 + (reach * -0.2 + push * 1.25), decay * -0.2 + gain * 1.25)


def test_coefficients_are_made_once_per_level(monkeypatch):
    calls = []

    def counted(*arguments):
        calls.append(arguments)
        return held_force_response(*arguments)

    monkeypatch.setattr(plant_step, "held_force_response", counted)
    step = make_step(board_params())
    state = (0.0, 0.0)
    for damping in (0.0, 1.0, 1.0, 0.0):
        for _ in range(50):
            state = step(state, 1.0, 0.0, damping, 4)
            state = step(state, 1.0, 0.0, damping, 2)
    assert [round(c - 0.36, 12) for _, c, _ in calls] == [0.0, 0.0, 1.0, 1.0, 0.0, 0.0]


def test_numbers_are_literals_in_the_source():
    source = step_source(STOPPED)
    for literal in ("0.008", "0.36", "16000.0", "-0.022", "0.022"):
        assert literal in source


def test_free_travel_has_no_comparison():
    assert " > " not in step_source(board_params())
    assert " > " in step_source(STOPPED)
    one_sided = step_source(board_params(upper_stop_m=0.01))
    assert " > " in one_sided
    assert " < " not in one_sided


@pytest.mark.parametrize("sign", [1, -1])
def test_stop_holds_and_releases(sign):
    step = make_step(STOPPED)
    state = (sign * 0.0219, 0.0)
    for _ in range(100):
        state = step(state, sign * 5.0, 0.0, 0.0, 4)
        assert abs(state[0]) <= 0.022
    assert state == (sign * 0.022, 0.0)
    freed = step(state, sign * -5.0, 0.0, 0.0, 4)
    _, gain, _, push = held_force_response(0.008, 0.36, 4 / 16000)
    assert freed == pytest.approx((sign * (0.022 - push * 5.0), sign * -gain * 5.0), rel=1e-14)


def test_stop_lets_an_inward_velocity_pass():
    assert make_step(STOPPED)((0.0221, -0.1), 0.0, 0.0, 0.0, 1)[1] < 0.0


def test_two_steps_do_not_share_a_level():
    first = make_step(board_params())
    second = make_step(board_params())
    first((0.0, 1.0), 0.0, 0.0, 5.0, 4)
    assert second((0.0, 1.0), 0.0, 0.0, 0.0, 4) == make_step(board_params())(
        (0.0, 1.0), 0.0, 0.0, 0.0, 4
    )


def test_traceback_shows_the_generated_line():
    with pytest.raises(ValueError, match="not enough values") as caught:
        make_step(board_params())((0.0,), 0.0, 0.0, 0.0, 4)
    shown = "".join(traceback.format_exception(caught.value))
    assert "<plant step " in shown
    assert "position, velocity = state" in shown


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass_kg": 0.0}, r"plant mass 0\.0 kg must be positive"),
        ({"mass_kg": nan}, r"plant mass nan kg must be positive"),
        ({"viscous_ns_per_m": -0.1}, r"plant damping -0\.1 Ns/m must be 0 or more"),
        ({"viscous_ns_per_m": inf}, r"plant damping inf Ns/m must be 0 or more"),
        ({"rate_hz": 0.0}, r"servo rate 0\.0 Hz must be positive"),
        (
            {"lower_stop_m": 0.01, "upper_stop_m": 0.01},
            r"stops at 0\.01 m and 0\.01 m leave no travel",
        ),
    ],
)
def test_impossible_devices_are_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        make_step(board_params(**changes))
