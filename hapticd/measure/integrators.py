"""Explicit Euler and Runge-Kutta 4 beside the exact map, on the linear device of a scene: where they blow up.

    exact   x(t + h) = e^(A h) x(t)                                      any h
    euler   R(z) = 1 + z                                                 |R(h lambda)| <= 1 for every eigenvalue lambda of A
    rk4     R(z) = 1 + z + z^2/2 + z^3/6 + z^4/24                        the same; about h < 2.79 / |lambda| for a real one

Electronics of microseconds decide the step, whether or not they matter: 5 kHz of amplifier bandwidth ask RK4 for a step below
88 us although the answer is spoken in milliseconds. A device that is let go with all bodies at one speed, over `SPAN_S`; the
error is that of the state, each coordinate over its largest value on the way.
"""

from dataclasses import dataclass

import numpy as np

from hapticd.analysis.arrays import Complexes, Floats
from hapticd.measure.scenes import level
from hapticd.plant.compose import compose
from hapticd.plant.expm import expm
from hapticd.plant.model import Array, Model
from hapticd.plant.scene import Scene

SPAN_S = 0.020
STEPS_PER_MS = tuple(2**k for k in range(12))
MARKS = 20  # points in time at which the error is taken
SPEED_M_PER_S = 0.1
BLOWN_UP = 1.0  # error beyond which nothing is left of the answer
METHODS = ("exact", "rk4", "euler")
LONGEST_S, BISECTIONS = 1.0, 80


@dataclass(frozen=True, eq=False)
class Comparison:
    """`error[method]` (S,) over `steps_per_ms` (S,); inf where it blew up. `longest_s[method]`: its largest stable step."""

    steps_per_ms: Floats
    error: dict[str, Floats]
    longest_s: dict[str, float]
    fastest_s: float  # time constant of the device


def compare(scene: Scene) -> Comparison:
    """Of the scene's device at its highest damping. ConfigError as `compose`."""
    model = compose(scene)
    a = model.a(level(scene))
    start = _let_go(model)
    true = _marks(expm(a * (SPAN_S / MARKS)), start, 1)
    size = np.abs(true).max(axis=0)
    size[size == 0.0] = 1.0
    error = {
        method: np.array(
            [_error(_marks(_step(method, a, 1e-3 / steps), start, _between(steps)), true, size) for steps in STEPS_PER_MS]
        )
        for method in METHODS
    }
    poles = np.asarray(np.linalg.eigvals(a), np.complex128)
    longest = {method: _longest(method, poles) for method in METHODS}
    fastest = float(np.abs(poles).max())
    return Comparison(np.array(STEPS_PER_MS, np.float64), error, longest, 1.0 / fastest if fastest else np.inf)


def _between(steps_per_ms: int) -> int:
    return round(1e3 * SPAN_S / MARKS * steps_per_ms)


def _let_go(model: Model) -> Floats:
    return np.array([SPEED_M_PER_S if state.name.endswith("_velocity") else 0.0 for state in model.states])


def _step(method: str, a: Array, h: float) -> Array:
    """The matrix that one step of a method multiplies the state with."""
    if method == "exact":
        return expm(a * h)
    orders = 4 if method == "rk4" else 1
    matrix = term = np.eye(len(a))
    for k in range(1, orders + 1):
        term = term @ a * (h / k)
        matrix = matrix + term
    return matrix


def _marks(step: Array, start: Floats, between: int) -> Floats:
    """(MARKS, n): the state at each mark, `between` steps apart."""
    found, x = [], start
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(MARKS):
            for _ in range(between):
                x = step @ x
            found.append(x)
    return np.array(found)


def _error(found: Floats, true: Floats, size: Floats) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        error = float(np.abs((found - true) / size).max())
    return error if error < BLOWN_UP else np.inf


def _longest(method: str, poles: Complexes) -> float:
    """The largest step at which no mode grows; inf for one that only drifts."""
    if method == "exact" or not poles.any():
        return np.inf
    poles = poles[np.abs(poles) > 1e-6 * np.abs(poles).max()]  # drift neither grows nor decays
    low, high = 0.0, LONGEST_S
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.all(np.abs(_growth(method, middle * poles)) <= 1.0) else (low, middle)
    return low


def _growth(method: str, z: Complexes) -> Floats:
    return np.asarray(1 + z if method == "euler" else 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24)
