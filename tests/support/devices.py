"""Devices for the tests of the engine, composed from effects and not read from files."""

from dataclasses import replace

from hapticd.model.compose import compose_device
from hapticd.model.effects import (
    Amplifier,
    AmplifierLimits,
    Coulomb,
    Coupling,
    DampingCircuit,
    Delay,
    Encoder,
    Load,
    MagnetCogging,
    Masses,
    Motor,
    PassiveHand,
    ProbeMass,
    Saturation,
    Smoothing,
    Viscous,
    WindingHeating,
    WindingTemperature,
    WorkspaceEnds,
)

MOTOR = Motor(torque_constant_nm_per_a=0.0165, lever_m=0.01, resistance_ohm=1.6)
RIGID = (Masses(rotor_kg=0.008), MOTOR)
TWO_MASSES = (
    Masses(rotor_kg=0.005, slider_kg=0.003),
    MOTOR,
    Coupling(stiffness_n_per_m=2e4, damping_ns_per_m=0.6),
    Viscous(rotor_ns_per_m=0.3),
)
STAR = (
    Masses(rotor_kg=0.0025, slider_kg=0.0025),
    MOTOR,
    ProbeMass(mass_kg=0.003),
    Coupling(stiffness_n_per_m=4e4, damping_ns_per_m=2.0),
    Viscous(rotor_ns_per_m=0.215, slider_ns_per_m=0.143),
    Smoothing(corner_hz=31.8),
    Amplifier(bandwidth_hz=5000.0),
    DampingCircuit(bandwidth_hz=1000.0),
    WindingTemperature(temperature_c=34.0, compensated_c=20.0),
)
COUNTS = Encoder(quantum_m=0.5e-6)
DRY = Coulomb(rotor_n=0.0293)
LIMIT = Saturation(limit_n=8.0)
# so low that the perturbation of a trial meets both of its limits
WEAK = AmplifierLimits(max_current_a=0.03, max_voltage_v=0.08, series_ohm=0.4, inductance_h=1e-4)
COGS = MagnetCogging(amplitude_n=0.05, pitch_m=0.004, phase_rad=0.3)
ENDS = WorkspaceEnds(lower_m=-0.002, upper_m=0.003)
HAND = PassiveHand(
    mass_kg=0.1,
    damping_ns_per_m=2.0,
    stiffness_n_per_m=100.0,
    grip_stiffness_n_per_m=2000.0,
    grip_damping_ns_per_m=5.0,
)
WARMING = WindingHeating(thermal_resistance_k_per_w=20.0, time_constant_s=10.0, ambient_c=20.0)
SPRING = Load(stiffness_n_per_m=500.0)


def device(*effects, delay=0.125, rate_hz=1000.0, **changes):
    """The composed model."""
    late = (Delay(periods=delay),) if delay else ()
    return replace(compose_device("test", (*effects, *late), rate_hz), **changes)


def rigid(damping_ns_per_m=0.3, *effects, delay=0.0, rate_hz=1000.0, mass_kg=0.008):
    """One mass with viscous damping."""
    parts = (Masses(rotor_kg=mass_kg), MOTOR, Viscous(rotor_ns_per_m=damping_ns_per_m), *effects)
    return device(*parts, delay=delay, rate_hz=rate_hz)
