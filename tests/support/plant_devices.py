"""Effects that the plant's tests compose: the Weir display as plain values, one by one."""

from typing import Any

from hapticd.model.compose import compose_device
from hapticd.model.effects import (
    Amplifier,
    Coulomb,
    Coupling,
    DampingCircuit,
    Delay,
    Effect,
    Masses,
    Motor,
    Multiplier,
    ProbeMass,
    Smoothing,
    Viscous,
    WindingTemperature,
)
from hapticd.model.model import Model

N_PER_A = 1.65  # 16.5 mNm/A over 10 mm

EFFECTS: dict[str, Effect] = {
    "masses": Masses(rotor_kg=0.0025, slider_kg=0.0025),
    "motor": Motor(torque_constant_nm_per_a=0.0165, lever_m=0.01, resistance_ohm=1.6),
    "probe": ProbeMass(mass_kg=0.003),
    "coupling": Coupling(stiffness_n_per_m=4e4, damping_ns_per_m=2.0),
    "viscous": Viscous(rotor_ns_per_m=0.2148, slider_ns_per_m=0.1432),
    "coulomb": Coulomb(rotor_n=0.0293),
    "delay": Delay(periods=0.125),
    "smoothing": Smoothing(corner_hz=31.8),
    "amplifier": Amplifier(bandwidth_hz=5e3),
    "damping_circuit": DampingCircuit(bandwidth_hz=1e3),
    "multiplier": Multiplier(gain_error=0.05),
    "winding": WindingTemperature(temperature_c=33.7, compensated_c=20.0),
}
FULL = tuple(name for name in EFFECTS if name not in ("masses", "motor"))


def weir_device(*names: str, **changed: Effect) -> Model:
    """A model of masses, motor and the named effects; keywords replace or add effects."""
    table: dict[str, Any] = {**EFFECTS, **changed}
    extra = [name for name in changed if name not in ("masses", "motor", *names)]
    return compose_device("test", [table[name] for name in ("masses", "motor", *names, *extra)])


def alpha(level_ns_per_m: float, residual_ohm: float, torque_constant_n_per_a: float) -> float:
    """Return the DC gain of command and damping with `residual_ohm` uncompensated: 1 / (1 + g dR /
    K^2).
    """
    return 1.0 / (1.0 + level_ns_per_m * residual_ohm / torque_constant_n_per_a**2)


def state_index(model: Model, name: str) -> int:
    """Index of the state of that name."""
    return [state.name for state in model.states].index(name)
