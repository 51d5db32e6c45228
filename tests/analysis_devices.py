"""Composed devices for the analysis: the rigid one of theory, and one like the calibrated
display.
"""

from hapticd.plant.compose import compose_device
from hapticd.plant.effects import (
    Amplifier,
    Coulomb,
    Coupling,
    DampingCircuit,
    Delay,
    Masses,
    Motor,
    ProbeMass,
    Smoothing,
    Viscous,
)
from hapticd.plant.model import Model

MOTOR = Motor(torque_constant_nm_per_a=0.0165, lever_m=0.01, resistance_ohm=1.6)


def rigid(mass_kg=0.008, viscous=2.0, delay=0.0, coulomb=0.0, scale=1.0, extra=()) -> Model:
    """One mass with damping and friction; `scale` bolts that many together."""
    effects = [
        Masses(rotor_kg=scale * mass_kg),
        MOTOR,
        Viscous(rotor_ns_per_m=scale * viscous),
        Delay(periods=delay),
        *extra,
    ]
    if coulomb:
        effects.append(Coulomb(rotor_n=scale * coulomb))
    return compose_device("rigid", effects)


def display(
    scale=1.0,
    coulomb=0.0293,
    slider_coulomb=0.0,
    viscous=0.358,
    delay=0.125,
    smoothing_hz=31.8,
    extra=(),
) -> Model:
    """Two masses, smoothing, amplifier and damping circuit, as the calibrated device has them."""
    effects = [
        Masses(rotor_kg=scale * 0.0025, slider_kg=scale * 0.0025),
        MOTOR,
        ProbeMass(mass_kg=scale * 0.003),
        Coupling(stiffness_n_per_m=scale * 4e4, damping_ns_per_m=scale * 2.0),
        Viscous(rotor_ns_per_m=scale * 0.6 * viscous, slider_ns_per_m=scale * 0.4 * viscous),
        Delay(periods=delay),
        Amplifier(bandwidth_hz=5e3),
        DampingCircuit(bandwidth_hz=1e3),
        *extra,
    ]
    if coulomb or slider_coulomb:
        effects.append(Coulomb(rotor_n=scale * coulomb, slider_n=scale * slider_coulomb))
    if smoothing_hz:
        effects.append(Smoothing(corner_hz=smoothing_hz))
    return compose_device("display", effects)
