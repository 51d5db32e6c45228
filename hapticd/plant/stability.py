"""Is the open device, without virtual environment, stable at a damping level? Eigenvalues, with the reason in words.

A device that nothing holds in place drifts: translation of all bodies together is an eigenvector with eigenvalue 0, and with
no damping at all a double one. It is divided out first (A t = 0 makes A block triangular in the basis t, t-perp), so what
is left decides, and rounding of a double zero is not mistaken for growth.

What can make it unstable is the damping circuit alone: resistance over-compensated beyond g dR / K^2 = -1, an inductance
error, or more damping than its bandwidth allows (the ceiling).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hapticd.plant.model import Array, Model

GROWTH_PER_S = 1e-6  # below this is rounding: e-fold in 11 days
HALVINGS = 80  # of an interval, until its ends are neighbours
NEAR_LOOP_GAIN = -0.95
NEAR = "resistance over-compensated almost to the limit; lower the damping or the compensation"


@dataclass(frozen=True, slots=True)
class Stability:
    """`growth_per_s` is the largest real part of an eigenvalue; `loop_gain` is g dR / K^2, unstable at -1.

    `reason` says why it is unstable, or that it nearly is.
    """

    stable: bool
    growth_per_s: float
    loop_gain: float
    reason: str


def stability(model: Model, damping_ns_per_m: float = 0.0) -> Stability:
    """Stability of the device alone at that damping level."""
    growth = float(modes(model, damping_ns_per_m).real.max())
    asked = model.level_gain * damping_ns_per_m + model.level_offset_ns_per_m
    loop = asked * model.residual_ohm / model.torque_constant_n_per_a**2
    stable = growth <= GROWTH_PER_S
    reason = _reason(loop, growth) if not stable else NEAR if loop < NEAR_LOOP_GAIN else ""
    return Stability(stable, growth, loop, reason)


def modes(model: Model, damping_ns_per_m: float = 0.0) -> "np.ndarray[tuple[int], np.dtype[np.complex128]]":
    """Eigenvalues [1/s] of the device, its free translation left out."""
    a = model.a(damping_ns_per_m)
    shift = np.array([1.0 if state.name.endswith("_position") else 0.0 for state in model.states])
    if not (a @ shift).any():
        a = _quotient(a, shift)
    return np.asarray(np.linalg.eigvals(a), dtype=np.complex128)


def damping_ceiling(model: Model, highest_ns_per_m: float = 1e6) -> float:
    """Largest damping level [Ns/m] at which the device is stable; `highest_ns_per_m` if there is no ceiling below it."""
    if stability(model, highest_ns_per_m).stable:
        return highest_ns_per_m
    return edge(lambda level: stability(model, level).stable, 0.0, highest_ns_per_m)


def edge(holds: Callable[[float], bool], inside: float, outside: float) -> float:
    """The last value at which something holds, on the way from `inside`, where it does, to
    `outside`, where it does not.
    """
    for _ in range(HALVINGS):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return inside


def _quotient(a: Array, shift: Array) -> Array:
    basis, _ = np.linalg.qr(np.column_stack([shift, np.eye(len(a))[:, np.argsort(-shift, kind="stable")[1:]]]))
    rest = basis[:, 1:]
    return np.asarray(rest.T @ a @ rest)


def _reason(loop: float, growth: float) -> str:
    if loop <= -1.0:
        return (
            f"resistance over-compensated, g dR / K^2 = {loop:.3g} (limit -1), growth {growth:.3g} 1/s; "
            "lower the damping or the compensation"
        )
    return f"the damping circuit oscillates, growth {growth:.3g} 1/s; lower the damping or widen its bandwidth"
