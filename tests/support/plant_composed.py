"""The composed device as straight-line Python: the same motion as the model's own maps, without
effects that the model does not have.
"""

from hapticd.model.compose import plant_params
from hapticd.model.discrete import discretise
from hapticd.model.effects import (
    AmplifierLimits,
    AntiAlias,
    Coulomb,
    DampingDac,
    Multiplier,
    PassiveHand,
    VelocityHighpass,
)
from hapticd.model.friction import stick_one, stick_two
from support.boards import board_params
from support.plant_devices import FULL, weir_device
from support.straight import held_force

H = 1e-3 / 16
LEVELS = (0.0, 1.74)
QUANTUM = 10.0 / 65535
EXACT = round(1.74 / QUANTUM) * QUANTUM
HAND = PassiveHand(
    mass_kg=0.006,
    damping_ns_per_m=1.0,
    stiffness_n_per_m=30.0,
    grip_stiffness_n_per_m=1500.0,
    grip_damping_ns_per_m=2.5,
)

WEAK = AmplifierLimits(max_current_a=0.03, max_voltage_v=0.08, series_ohm=0.4, inductance_h=1e-4)

MODELS = {
    "whole": weir_device(*FULL, dac=DampingDac(quantum_ns_per_m=QUANTUM)),
    "linear": weir_device("probe", "viscous", "coupling", "amplifier"),
    "rigid": weir_device("probe", "viscous"),
    "slider": weir_device("coupling", coulomb=Coulomb(rotor_n=0.0, slider_n=0.02)),
    "both": weir_device("coupling", "viscous", coulomb=Coulomb(rotor_n=0.02, slider_n=0.01)),
    "hand": weir_device(*FULL, hand=HAND),
    "hand on a rigid one": weir_device("probe", coulomb=Coulomb(rotor_n=0.03), hand=HAND),
    "offset": weir_device(
        "probe", "coulomb", "amplifier", multiplier=Multiplier(velocity_offset_m_per_s=0.02)
    ),
    # so low that pushes of 0.1 N meet both of its limits
    "limits": weir_device(*FULL, limits=WEAK),
    "limits on a rigid one": weir_device("probe", "viscous", "amplifier", limits=WEAK),
    "filters": weir_device(
        "probe",
        "viscous",
        highpass=VelocityHighpass(corner_hz=0.1),
        alias=AntiAlias(corner_hz=1800.0),
    ),
}


def board(model, levels=LEVELS, **changes):
    return board_params(plant=plant_params(model, H, levels, 10.0), **changes)


def forces(model, level, x, u):
    """Friction of one sub-step by the functions of `friction`."""
    step = discretise(model, H, level)
    free = step.a @ x + step.b @ u
    if model.drive is not None:
        place = model.drive.motor_force
        column = step.b[:, model.inputs.amplifier]
        held = float(held_force(model.drive, free, x, H))
        free = free + column * ((held - free[place]) / column[place])
    after = free
    if len(model.contacts) == 1:
        c = model.contacts[0]
        found = [stick_one(free[c.velocity], step.b[c.velocity, c.column], c.level_n)]
    elif model.contacts:
        c, d = model.contacts
        w = [step.b[i.velocity, j.column] for i in (c, d) for j in (c, d)]
        found = list(stick_two(free[c.velocity], free[d.velocity], *w, c.level_n, d.level_n))
    else:
        found = []
    for contact, force in zip(model.contacts, found, strict=True):
        after = after + step.b[:, contact.column] * force
    for contact, force in zip(model.contacts, found, strict=True):
        if abs(force) < contact.level_n:
            after[contact.velocity] = 0.0
            if x[contact.velocity] == 0.0:
                after[contact.position] = x[contact.position]
    return after
