"""Active damping that remains in an impact, by the model with the netlist's numbers.

The display, with a hand of 0.1 kg on its endpoint, meets a virtual wall, K = 500 N/m and B = 2 N
s/m, at a speed. Until it turns round, the motor produces command and active damping together. The
share of the damping:

    delivered = integral of (alpha F_r - F) v / integral of v^2

F_r is the command after its smoothing filter, F the motor force, alpha as in `studies`. The law is
that of hapticd without its velocity filter, at 1 kHz, limited to 8 N.
"""

from dataclasses import replace
from functools import cache

from firmware_iface.hardware.device_file import NAME
from hapticd.model.effects import AmplifierLimits, Effect, Load
from hapticd.model.params import BoardParams
from hapticd.model.step import SUBSTEPS_PER_TICK, Plant, make_plant
from hapticd.settings.build import board_of, device_effects
from hapticd.zwidth.sources import device_file

__all__ = ["LEVELS", "delivered"]

HAND_KG = 0.1
STIFFNESS_N_PER_M = 500.0
VIRTUAL_DAMPING_NS_PER_M = 2.0
COMMAND_N = 8.0
LEVELS = (1.74, 5.0)  # N s/m
RATE_HZ = 1000.0
EFFECTS = (
    "probe", "coupling", "viscous", "smoothing", "amplifier", "damping_circuit", "winding",
    "inductance",
)  # fmt: skip


def delivered(speed_m_per_s: float, level_ns_per_m: float, current_a: float | None = None) -> float:
    """Return the damping [N s/m] delivered on the way into the wall by an amplifier limited to
    `current_a`, by default without limits. `level_ns_per_m` is one of `LEVELS`.
    """
    params, plant = _board(current_a)
    composed = params.plant
    assert composed is not None
    rho = composed.residuals_ohm[0] / params.torque_constant_n_per_a**2
    alpha = 1.0 / (1.0 + level_ns_per_m * rho)
    rotor = composed.states.index("rotor_velocity")
    smoothed = composed.states.index("smoothed_force")
    moving = [speed_m_per_s if name.endswith("_velocity") else 0.0 for name in composed.states]
    state, work, squares, before_m = tuple(moving), 0.0, 0.0, 0.0
    while True:
        position_m = plant.encoder(state, 0.0, level_ns_per_m)
        force_n = _law(position_m, position_m - before_m)
        before_m = position_m
        for _ in range(SUBSTEPS_PER_TICK):
            state = plant.step(state, force_n, 0.0, level_ns_per_m, 1)
            velocity = state[rotor]
            if velocity <= 0.0:
                return work / squares
            motor_n = plant.motor_force(state, force_n, level_ns_per_m)
            work += (alpha * state[smoothed] - motor_n) * velocity
            squares += velocity * velocity


def _law(position_m: float, step_m: float) -> float:
    """Return the force [N] of the wall at 0, `step_m` after the position of the tick before."""
    asked = STIFFNESS_N_PER_M * position_m + VIRTUAL_DAMPING_NS_PER_M * step_m * RATE_HZ
    return -min(asked, COMMAND_N) if position_m > 0.0 else 0.0


@cache
def _board(current_a: float | None) -> tuple[BoardParams, Plant]:
    device = device_file(NAME)
    names = EFFECTS if current_a is None else (*EFFECTS, AmplifierLimits.key)
    effects = [_given(one, current_a) for one in device_effects(device, names)]
    params = board_of(device, RATE_HZ, (*effects, Load(mass_kg=HAND_KG)), (0.0, *LEVELS))
    return params, make_plant(params)


def _given(effect: Effect, current_a: float | None) -> Effect:
    if isinstance(effect, AmplifierLimits) and current_a is not None:
        return replace(effect, max_current_a=current_a)
    return effect
