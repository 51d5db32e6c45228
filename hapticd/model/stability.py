"""Stability of the open device at a damping level, with its reason.

The eigenvalues without virtual environment decide. A device that nothing holds in place drifts:
translation of all bodies together is an eigenvector with eigenvalue 0, and without damping a double
one. It is divided out first (A t = 0 makes A block triangular in the basis t, t-perp), so the rest
decides, and rounding of a double zero is not mistaken for growth.

Only the damping circuit can make it unstable: resistance over-compensated beyond g dR / K^2 = -1,
an inductance error, or more damping than its bandwidth allows (the ceiling). `explain` lists
states, modes, nonlinearities, and the purpose of each effect.

A position must be a state named ..._position (its translation would otherwise not be divided out).
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import inf, tau

import numpy as np

from hapticd.model.blueprint import Note, StateVariable
from hapticd.model.discrete import computable
from hapticd.model.model import Array, Model

__all__ = ["AtLevel", "Explanation", "damping_ceiling", "edge", "explain", "modes", "stability"]

GROWTH_PER_S = 1e-6  # below this is rounding: e-fold in 11 days
HALVINGS = 80  # of an interval, until its ends are neighbours
NEARLY_ZERO_PER_S = 1e-9  # an eigenvalue below this is drift: no time constant, no damping ratio
NEAR_LOOP_GAIN = -0.95  # of -1, where the circuit oscillates
NEAR = "resistance over-compensated almost to the limit; lower the damping or the compensation"


@dataclass(frozen=True, slots=True)
class Stability:
    """Whether the open device is stable at a damping level, by how much, and why."""

    stable: bool
    growth_per_s: float  # largest real part of an eigenvalue
    loop_gain: float  # g dR / K^2; the circuit oscillates at -1
    reason: str  # why it is unstable or nearly so; otherwise empty


def stability(model: Model, active_damping_ns_per_m: float = 0.0) -> Stability:
    """Return the stability of the device alone at that damping level. ConfigError: out of range."""
    growth = float(modes(model, active_damping_ns_per_m).real.max())
    asked = model.level_gain * active_damping_ns_per_m + model.level_offset_ns_per_m
    with computable(model.name, "the gain of the damping circuit"):
        loop = asked * model.residual_ohm / model.torque_constant_n_per_a**2
    stable = growth <= GROWTH_PER_S
    if not stable:
        return Stability(stable, growth, loop, _reason(loop, growth))
    return Stability(stable, growth, loop, NEAR if loop < NEAR_LOOP_GAIN else "")


def modes(
    model: Model, active_damping_ns_per_m: float = 0.0
) -> "np.ndarray[tuple[int], np.dtype[np.complex128]]":
    """Return eigenvalues [1/s] of the device without free translation. ConfigError: out of
    range.
    """
    with computable(model.name, f"the modes at {active_damping_ns_per_m:g} N s/m"):
        a = model.a(active_damping_ns_per_m)
        if model.drifts(active_damping_ns_per_m):
            a = _quotient(a, model.translation())
        return np.asarray(np.linalg.eigvals(a), dtype=np.complex128)


def damping_ceiling(model: Model, highest_ns_per_m: float = 1e6) -> float:
    """Return the largest stable damping level [Ns/m] of the device, at most `highest_ns_per_m`."""
    if stability(model, highest_ns_per_m).stable:
        return highest_ns_per_m
    return edge(lambda level: stability(model, level).stable, 0.0, highest_ns_per_m)


def edge(
    holds: Callable[[float], bool], inside: float, outside: float, halvings: int = HALVINGS
) -> float:
    """Return the last value for which `holds` is true, between `inside` (true) and `outside`."""
    for _ in range(halvings):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if holds(middle) else (inside, middle)
    return inside


def _quotient(a: Array, shift: Array) -> Array:
    """Return A after translation of all bodies together is divided out."""
    others = np.eye(len(a))[:, np.argsort(-shift, kind="stable")[1:]]  # all axes but one position
    basis, _ = np.linalg.qr(np.column_stack([shift, others]))
    rest = basis[:, 1:]
    return np.asarray(rest.T @ a @ rest)


def _reason(loop: float, growth: float) -> str:
    if loop <= -1.0:
        return (
            f"resistance over-compensated, g dR / K^2 = {loop:.3g} (limit -1), growth {growth:.3g}"
            " 1/s; lower the damping or the compensation"
        )
    return (
        f"the damping circuit oscillates, growth {growth:.3g} 1/s; lower the damping or widen its"
        " bandwidth"
    )


@dataclass(frozen=True, slots=True)
class Mode:
    """An eigenvalue of the open device; a conjugate pair is one mode."""

    time_constant_s: float  # of its envelope; infinite if it neither decays nor grows
    frequency_hz: float  # 0 for a real eigenvalue
    damping_ratio: float  # 1 for a real eigenvalue that decays, -1 for one that grows


@dataclass(frozen=True, slots=True)
class AtLevel:
    """The open device at one damping level."""

    active_damping_ns_per_m: float  # active damping
    stability: Stability
    alpha: float  # factor on damping and force at DC
    modes: tuple[Mode, ...]  # from slow to fast


@dataclass(frozen=True, slots=True)
class Explanation:
    """The parts of a composed model, and its behaviour at some damping levels."""

    states: tuple[StateVariable, ...]
    nonlinearities: tuple[tuple[str, str], ...]  # effect, description
    notes: tuple[Note, ...]  # purpose of each effect
    levels: tuple[AtLevel, ...]
    delay_s: float  # from the encoder sample to its command
    fastest_s: float  # shortest time constant of all


def explain(model: Model, levels_ns_per_m: Iterable[float] = (0.0,)) -> Explanation:
    """Describe `model`, with its modes at these damping levels."""
    found = tuple(at_level(model, level) for level in levels_ns_per_m)
    highest = max(level.active_damping_ns_per_m for level in found)
    return Explanation(
        states=model.states,
        nonlinearities=tuple(
            (note.effect, note.nonlinearity) for note in model.notes if note.nonlinearity
        ),
        notes=model.notes,
        levels=found,
        delay_s=model.delay_periods / model.rate_hz,
        fastest_s=min((1.0 / abs(value) for value in modes(model, highest) if value), default=inf),
    )


def at_level(model: Model, active_damping_ns_per_m: float) -> AtLevel:
    """Return stability and modes of the open device at that damping level."""
    verdict = stability(model, active_damping_ns_per_m)
    upper = [complex(value) for value in modes(model, active_damping_ns_per_m) if value.imag >= 0.0]
    return AtLevel(
        active_damping_ns_per_m,
        verdict,
        1.0 / (1.0 + verdict.loop_gain),
        tuple(_mode(value) for value in sorted(upper, key=abs)),
    )


def _mode(value: complex) -> Mode:
    size = abs(value)
    decay = -value.real
    time_constant_s = 1.0 / decay if abs(decay) > NEARLY_ZERO_PER_S else inf
    return Mode(
        time_constant_s, abs(value.imag) / tau, decay / size if size > NEARLY_ZERO_PER_S else 0.0
    )
