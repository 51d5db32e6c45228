"""Exact discretisation: closed forms, composition of pieces, commands that change inside a step;
the matrix exponential against 60-digit decimals.
"""

from decimal import Decimal, getcontext
from math import cos, exp, pi, sin, sqrt

import numpy as np
import pytest
from support.plant_devices import FULL, weir_device

from hapticd.model.discrete import delay_steps, discretise, expm, late_command
from hapticd.model.effects import Amplifier, Coupling, DampingCircuit, Masses
from hapticd.model.step import held_force_response


def decimal_expm(matrix):
    """e^M by a Taylor series in 60 digits, halved 40 times and squared back."""
    getcontext().prec = 60
    n = len(matrix)
    halvings = 40
    small = [[Decimal(float(item)) / 2**halvings for item in row] for row in matrix]
    identity = [[Decimal(int(i == j)) for j in range(n)] for i in range(n)]

    def product(a, b):
        return [[sum(a[i][k] * b[k][j] for k in range(n)) for j in range(n)] for i in range(n)]

    total = identity
    for k in range(20, 0, -1):
        step = product(small, total)
        total = [[identity[i][j] + step[i][j] / k for j in range(n)] for i in range(n)]
    for _ in range(halvings):
        total = product(total, total)
    return np.array([[float(item) for item in row] for row in total])


def block(model, level, h):
    n, m = model.b0.shape
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[:n, n:] = model.a(level), model.b(level)
    return whole * h


@pytest.mark.parametrize("level", [0.0, 1.74, 10.0])
@pytest.mark.parametrize("h", [1e-3 / 16, 1e-3])
def test_stiff_electronics_to_the_last_digits(level, h):
    stiff = weir_device(
        *FULL,
        amplifier=Amplifier(bandwidth_hz=5e4),
        damping_circuit=DampingCircuit(bandwidth_hz=2e4),
    )
    matrix = block(stiff, level, h)
    reference = decimal_expm(matrix)
    found = expm(matrix)
    largest = abs(reference).max(axis=1, keepdims=True)
    assert (abs(found - reference) / largest).max() < 4e-16


def test_every_entry_is_accurate():
    matrix = block(weir_device("probe", "coupling", "viscous"), 0.0, 1e-3)
    reference = decimal_expm(matrix)
    found = expm(matrix)
    there = abs(reference) > 1e-12 * abs(reference).max(axis=1, keepdims=True)
    assert (abs(found - reference)[there] / abs(reference)[there]).max() < 1e-13


def test_closed_forms():
    assert expm(np.zeros((3, 3))).tolist() == np.eye(3).tolist()
    assert expm(np.array([[0.0, 5.0], [0.0, 0.0]])).tolist() == [[1.0, 5.0], [0.0, 1.0]]
    turned = expm(np.array([[0.0, -3.0], [3.0, 0.0]]))
    assert turned == pytest.approx(np.array([[cos(3), -sin(3)], [sin(3), cos(3)]]), abs=1e-15)
    assert expm(np.diag([-700.0, 2.0])) == pytest.approx(np.diag([exp(-700), exp(2)]), rel=1e-13)


def test_badly_scaled_units_do_not_hurt():
    a = np.array([[-1.0, 1e12], [1e-12, -3.0]])
    plain = expm(np.array([[-1.0, 1.0], [1.0, -3.0]]))
    assert expm(a) == pytest.approx(plain * np.array([[1.0, 1e12], [1e-12, 1.0]]), rel=1e-14)


def test_not_finite_is_refused():
    with pytest.raises(ValueError, match="exponential of a matrix that is not finite"):
        expm(np.array([[np.nan]]))


def test_rigid_mass_is_the_closed_form():
    model = weir_device("probe", "viscous")
    found = discretise(model, 1e-3, 1.74)
    decay, gain, reach, push = held_force_response(0.008, 0.358 + 1.74, 1e-3)
    assert found.a == pytest.approx(np.array([[1.0, reach], [0.0, decay]]), rel=1e-15)
    assert found.b[:, model.inputs.command] == pytest.approx([push, gain], rel=1e-14)
    assert found.b[:, model.inputs.torque] == pytest.approx([push, gain], rel=1e-14)


@pytest.mark.parametrize("pieces", [2, 16, 100])
def test_pieces_compose_to_the_whole(pieces):
    model = weir_device(*FULL)
    whole = discretise(model, 1e-3, 1.74)
    piece = discretise(model, 1e-3 / pieces, 1.74)
    x = np.linspace(-1.0, 1.0, 7) * 1e-3
    u = np.array([0.5, -0.2, 0.03])
    stepped = x
    for _ in range(pieces):
        stepped = piece.a @ stepped + piece.b @ u
    assert stepped == pytest.approx(whole.a @ x + whole.b @ u, rel=1e-12, abs=1e-16)


@pytest.mark.parametrize("fraction", [0.0, 0.125, 1 / 3, 0.9, 1.0])
def test_late_command_is_two_exact_pieces(fraction):
    model = weir_device(*FULL)
    h = 1e-3
    whole = discretise(model, h, 1.74)
    old, new = late_command(model, whole, fraction)
    x, (before, after) = np.array([1e-3, 0.1, 1e-3, 0.1, 0.2, 0.1, 0.1]), (0.7, -0.4)
    first = discretise(model, fraction * h, 1.74)
    second = discretise(model, (1 - fraction) * h, 1.74)
    column = model.inputs.command
    middle = first.a @ x + first.b[:, column] * before
    expected = second.a @ middle + second.b[:, column] * after
    assert whole.a @ x + old * before + new * after == pytest.approx(expected, rel=1e-13, abs=1e-17)


@pytest.mark.parametrize(
    ("periods", "steps", "expected"),
    [
        (0.125, 16, (2, 0.0)),
        (0.125, 4, (0, 0.5)),
        (1.4375, 16, (23, 0.0)),
        (1.0, 1, (1, 0.0)),
        (0.3, 10, (3, 0.0)),
    ],
)
def test_delay_is_split_into_steps_and_a_rest(periods, steps, expected):
    count, fraction = delay_steps(periods * steps)
    assert (count, pytest.approx(fraction, abs=1e-12)) == expected


def test_lightly_damped_coupling_decays_as_it_should():
    """Two masses on a spring, relative motion: e^(-zeta w t) (cos w_d t + zeta / sqrt(1 -
    zeta^2) sin w_d t).
    """
    stiffness = 4e4
    damping = 0.02
    m1 = 0.0055
    m2 = 0.0025
    model = weir_device(
        masses=Masses(rotor_kg=m1 + 0.0, slider_kg=m2),
        coupling=Coupling(stiffness_n_per_m=stiffness, damping_ns_per_m=damping),
    )
    reduced = m1 * m2 / (m1 + m2)
    w = sqrt(stiffness / reduced)
    zeta = damping / (2 * sqrt(stiffness * reduced))
    wd = w * sqrt(1 - zeta**2)
    step = discretise(model, 1e-3 / 16)
    x = np.array([m2 / (m1 + m2), 0.0, -m1 / (m1 + m2), 0.0]) * 1e-4
    x0 = x[0] - x[2]
    assert w / (2 * pi) == pytest.approx(767, abs=1)
    assert zeta < 2e-3
    for k in range(1, 4001):
        x = step.a @ x
        t = k * 1e-3 / 16
        expected = x0 * exp(-zeta * w * t) * (cos(wd * t) + zeta / sqrt(1 - zeta**2) * sin(wd * t))
        assert x[0] - x[2] == pytest.approx(expected, abs=1e-11 * x0)
    assert m1 * x[0] + m2 * x[2] == pytest.approx(0.0, abs=1e-16)
