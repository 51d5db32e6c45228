"""Composed devices for the analysis tests: the rigid device of theory, one like the calibrated
display, and the tick law applied to such a device.
"""

import numpy as np

from hapticd.core.environment import Environment, FilterParams
from hapticd.model.compose import compose_device
from hapticd.model.discrete import discretise
from hapticd.model.effects import (
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
from hapticd.model.model import Model
from hapticd.render.law import at_rest, design_coefficients, render
from support.models import environment_tuple

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


def law_on_device(model, point, torque):
    """The true law of the servo around the exact map of the device; the mean velocity at 4 kHz.
    The delay is T/4, T is 1 ms.
    """
    environment = environment_tuple(Environment(*point), 1e9)
    coefficients = design_coefficients(FilterParams(100.0), FilterParams(72.0), model.rate_hz)
    step = discretise(model, 0.25e-3)
    law = at_rest(0.0)
    force = 0.0
    before = 0.0
    x = np.zeros(len(step.a))
    travel = np.zeros(torque.size + 1)
    command = step.b[:, model.inputs.command]
    probe = step.b[:, model.inputs.torque]
    encoder = model.outputs.encoder.row()
    recorded = model.outputs.recorded_travel.row()
    for k, push in enumerate(torque):
        if k % 4 == 0:
            before = force
            force, *_, law = render(float(encoder @ x), law, environment, coefficients)
        x = step.a @ x + command * (force if k % 4 else before) + probe * push
        travel[k + 1] = recorded @ x
    return np.diff(travel) * 4000.0
