"""The generated step: what it computes, what it leaves out, and that a traceback shows it."""

import traceback
from math import inf, nan

import pytest
from boards import board_params

import hapticd.plant.step as plant_step
from hapticd.errors import ConfigError
from hapticd.plant.mechanics import held_force_response
from hapticd.plant.step import make_step, rest_state, step_source

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
    step, state = make_step(board_params()), rest_state(board_params())
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
    step, state = make_step(STOPPED), rest_state(STOPPED, sign * 0.0219)
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
    first, second = make_step(board_params()), make_step(board_params())
    first((0.0, 1.0), 0.0, 0.0, 5.0, 4)
    assert second((0.0, 1.0), 0.0, 0.0, 0.0, 4) == make_step(board_params())((0.0, 1.0), 0.0, 0.0, 0.0, 4)


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
        ({"lower_stop_m": 0.01, "upper_stop_m": 0.01}, r"stops at 0\.01 m and 0\.01 m leave no travel"),
    ],
)
def test_impossible_devices_are_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        make_step(board_params(**changes))
