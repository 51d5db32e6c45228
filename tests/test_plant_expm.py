"""The matrix exponential against 60-digit decimals and closed forms."""

from decimal import Decimal, getcontext
from math import cos, exp, sin

import numpy as np
import pytest
from plant_devices import FULL, device

from hapticd.plant.electrical import Amplifier, DampingCircuit
from hapticd.plant.expm import expm


def decimal_expm(matrix):
    """e^M by a Taylor series in 60 digits, halved 40 times and squared back."""
    getcontext().prec = 60
    n, halvings = len(matrix), 40
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
    stiff = device(*FULL, amplifier=Amplifier(bandwidth_hz=5e4), damping_circuit=DampingCircuit(bandwidth_hz=2e4))
    matrix = block(stiff, level, h)
    reference, found = decimal_expm(matrix), expm(matrix)
    largest = abs(reference).max(axis=1, keepdims=True)
    assert (abs(found - reference) / largest).max() < 4e-16


def test_every_entry_is_accurate():
    matrix = block(device("probe", "coupling", "viscous"), 0.0, 1e-3)
    reference, found = decimal_expm(matrix), expm(matrix)
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
