"""From a scene to a `Model`, and from a model to the numbers of board.json.

Model (`compose`). Every effect of the scene writes its part, the loop of the damping circuit is
closed, and the linear part becomes one state-space model. Absent effects add nothing: a rigid
device without extras has two states. The loop of the damping circuit (Weir 2008, Fig. 6) is
estimate, multiplier, amplifier, force on the rotor:

    F_r'   = w_r (F_cmd - F_r)                               smoothing of the command
    F_a'   = w_a (F_r - g(b) (v_hat + e) - F_a)              current amplifier, as endpoint force
    v_hat' = w_d (v_rotor + (dR / K^2) F_a + (dL / K^2) F_a' - v_hat)
                                            Eq. 6: (V - R i - L di/dt) / K_emf, i = F_a / K
    `effects.shaped`, if the scene has it, is between v_hat and g(b)
    g(b)   = (1 + gain error) b + scale offset;  e = offset and noise of the estimate

If the scene limits the amplifier, `friction.reach` adds to F_a'.

b is the commanded damping in Ns/m, K = K_m / r the force per ampere at the endpoint, dR and dL the
uncancelled resistance and inductance. At DC F_a = alpha (F_r - g v) with alpha = 1 / (1 + g dR /
K^2). A hot winding weakens damping AND force. Over-compensation strengthens both until the circuit
oscillates at g dR / K^2 = -1. The inductance error must stay above -(1 / w_a + 1 / w_d) K^2 / g.

The open device (no virtual environment) must be stable at every damping level of the scene. A
damping circuit beyond one of these limits is refused, unless the scene sets `allow_unstable`.
Errors of resistance or inductance are refused without the lags that make the loop a differential
equation.

Numbers of board.json (`board_fields`). They are exact maps at a grid of damping levels, each over
one sub-step. The levels that a configuration uses are nodes, so a board at one of them is exact.
Between nodes, while the servo slews, maps are interpolated linearly. With `GRID` nodes over 10 Ns/m
the error of an interpolated sub-step is below 1e-6 of the velocity. A winding that heats up adds a
second axis, its residual resistance. Limitations: a highest level far above 10 Ns/m with the same
grid, or a winding hotter than `HOTTEST_C` (the outermost maps are extrapolated linearly).
"""

from collections.abc import Iterable
from dataclasses import asdict
from math import floor
from typing import Any

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.core.errors import ConfigError
from hapticd.model.blueprint import ZERO, Blueprint, Form, InputColumns
from hapticd.model.discrete import (
    computable,
    discretise,
    drive_response_s,
    require_finite,
    stability,
)
from hapticd.model.effects import (
    Amplifier,
    DampingCircuit,
    Effect,
    ShapedDamping,
    copper_ohm,
    in_order,
    shaped,
)
from hapticd.model.model import (
    Contact,
    DriveLimits,
    Ends,
    Model,
    Noise,
    Output,
    Outputs,
    RotorForce,
    Winding,
    frozen,
)
from hapticd.model.params import PlantParams
from hapticd.model.scene import Scene
from hapticd.model.step import SUBSTEPS_PER_TICK

__all__ = ["board_fields", "compose", "compose_device", "refuse_unstable"]

# --- model ----------------------------------------------------------------------------------------


def drive(plan: Blueprint) -> None:
    """Close the loop of the damping circuit: estimate, multiplier, amplifier, force on the rotor.
    ConfigError if a lag is missing or in excess.
    """
    rotor = plan.rotor
    if plan.crowbar:
        _short(plan)
        return
    _refuse_algebraic(plan)
    limited = plan.input("amplifier") if plan.amplifier_range else Form()
    # states in this order: the motor force first, then the estimate
    motor = plan.state("motor_force", "N", Amplifier.key) if plan.amplifier_rad_s else None
    estimate = _estimate(plan, motor)
    asked = plan.command - _multiplied(plan, shaped(plan, estimate))
    if motor is None or not plan.amplifier_rad_s:
        motor = asked  # an amplifier without lag
    else:
        plan.rates["motor_force"] = plan.amplifier_rad_s * (asked - motor) + limited
    if plan.circuit_rad_s:
        plan.rates["velocity_estimate"] = plan.circuit_rad_s * (_seen(plan, motor) - estimate)
    plan.motor = motor
    plan.estimate = estimate
    rotor.force += motor


def _estimate(plan: Blueprint, motor: Form | None) -> Form:
    """Return v_hat: a state of its own, or without a bandwidth the algebraic estimate."""
    if plan.circuit_rad_s:
        return plan.state("velocity_estimate", "m/s", DampingCircuit.key)
    return plan.rotor.velocity + (Form() if motor is None else _left_by_resistance(plan, motor))


def _seen(plan: Blueprint, motor: Form) -> Form:
    """Return the velocity from the back-EMF, with the uncancelled part of R i and L di/dt."""
    seen = plan.rotor.velocity + _left_by_resistance(plan, motor)
    if not plan.inductance_error_h:
        return seen
    per_rate = plan.inductance_error_h / plan.torque_constant_n_per_a**2
    return seen + per_rate * plan.rates["motor_force"]


def _left_by_resistance(plan: Blueprint, motor: Form) -> Form:
    return motor.times_residual() / plan.torque_constant_n_per_a**2


def _multiplied(plan: Blueprint, estimate: Form) -> Form:
    if plan.estimate_offset_m_per_s or plan.estimate_psd:
        estimate += plan.input("estimate")
    return plan.level_gain * estimate.times_level() + plan.level_offset_ns_per_m * estimate


def _refuse_algebraic(plan: Blueprint) -> None:
    lags = (plan.amplifier_rad_s is not None) + (plan.circuit_rad_s is not None)
    changing = plan.residual_ohm or plan.heating
    if changing and not lags:
        raise ConfigError(
            f"a resistance error of {plan.residual_ohm:g} ohm needs a lag in the damping loop; "
            "add the effect 'amplifier' or 'damping_circuit'"
        )
    if plan.inductance_error_h and lags < 2:
        raise ConfigError(
            f"an inductance error of {plan.inductance_error_h:g} H differentiates the current; "
            "add the effects 'amplifier' and 'damping_circuit'"
        )
    if plan.amplifier_range and plan.amplifier_rad_s is None:
        raise ConfigError("limits of an amplifier need its bandwidth; add the effect 'amplifier'")


def _short(plan: Blueprint) -> None:
    driven = plan.amplifier_rad_s or plan.circuit_rad_s or plan.amplifier_range
    if driven or plan.inductance_error_h or any(plan.shaping_rad_s):
        raise ConfigError(
            "a crowbar shorts the motor: leave out 'amplifier', 'amplifier_limits',"
            f" 'damping_circuit', {ShapedDamping.key!r} and 'inductance'"
        )
    damping = plan.torque_constant_n_per_a**2 / plan.resistance_ohm
    plan.motor = -damping * plan.rotor.velocity
    plan.estimate = plan.rotor.velocity
    plan.rotor.force += plan.motor


def compose(scene: Scene) -> Model:
    """Return the model of `scene`. ConfigError if its effects contradict each other or the open
    device is unstable.
    """
    model = compose_device(scene.name, scene.effects, scene.rate_hz)
    if not scene.allow_unstable:
        levels = [step.level_ns_per_m for step in scene.active_damping]
        refuse_unstable(model, levels, "; set allow_unstable = true to simulate it all the same")
    return model


def refuse_unstable(model: Model, levels_ns_per_m: Iterable[float], remedy: str = "") -> None:
    """Raise ConfigError if the open device is unstable at one of these damping levels."""
    for level in levels_ns_per_m:
        found = stability(model, level)
        if not found.stable:
            raise ConfigError(
                f"{model.name!r}: the device without virtual environment is unstable at {level:g} N"
                f" s/m: {found.reason}{remedy}"
            )


def compose_device(name: str, effects: Iterable[Effect], rate_hz: float = 1000.0) -> Model:
    """Return the model of a device with these effects, whatever its stability. ConfigError if its
    numbers are out of range.
    """
    plan = Blueprint()
    chosen = in_order(effects)
    plan.command = plan.input("command")
    torque = plan.input("torque")
    for effect in chosen:
        with computable(name, f"the effect {effect.key!r}"):
            effect.build(plan)
    with computable(name, "the device"):
        plan.rotor.force += torque
        drive(plan)
        for effect in chosen:
            own = tuple(state.name for state in plan.states if state.effect == effect.key)
            plan.notes.append(effect.note_of(own))
        model = _model(name, plan, rate_hz)
    require_finite(name, "the device", model.a0, model.a1, model.b0, model.b1)
    return model


def _model(name: str, plan: Blueprint, rate_hz: float) -> Model:
    states = [state.name for state in plan.states]
    n = len(states)
    contacts = _contacts(plan, states)
    columns = {name: column for column, name in enumerate(plan.inputs)}
    inputs = InputColumns(**columns, width=len(columns) + len(contacts))
    one, level, residual, both = _coefficients(plan, states, contacts)
    fixed = one + plan.residual_ohm * residual
    per_level = level + plan.residual_ohm * both
    noise = plan.velocity_noise_m_per_s, plan.estimate_psd
    per_ohm = [
        frozen(part) for part in (residual[:, :n], both[:, :n], residual[:, n:], both[:, n:])
    ]
    heating = plan.heating
    return Model(
        name=name,
        rate_hz=rate_hz,
        delay_periods=plan.delay_periods,
        states=tuple(plan.states),
        a0=frozen(fixed[:, :n]),
        a1=frozen(per_level[:, :n]),
        b0=frozen(fixed[:, n:]),
        b1=frozen(per_level[:, n:]),
        inputs=inputs,
        outputs=_outputs(plan, states, inputs.width),
        contacts=contacts,
        **plan.numbers,
        ends=_ends(plan, states),
        rotor_forces=tuple(
            RotorForce(law, numbers, states.index("rotor_position"), states.index("rotor_velocity"))
            for law, numbers in plan.rotor_forces
        ),
        drive=_drive(plan, states),
        noise=Noise(*noise) if any(noise) else None,
        winding=None if heating is None else Winding(heating, plan.residual_ohm, *per_ohm),
        estimate_offset_m_per_s=plan.estimate_offset_m_per_s,
        level_gain=plan.level_gain,
        level_offset_ns_per_m=plan.level_offset_ns_per_m,
        mass_kg=sum(body.mass_kg for body in plan.bodies.values() if body.name != "hand"),
        probe_mass_kg=plan.probe_mass_kg,
        viscous_ns_per_m=plan.viscous_ns_per_m,
        torque_constant_n_per_a=plan.torque_constant_n_per_a,
        resistance_ohm=plan.resistance_ohm,
        temperature_c=plan.copper.start_c,
        residual_ohm=plan.residual_ohm,
        notes=tuple(plan.notes),
    )


def _coefficients(plan: Blueprint, states: list[str], contacts: tuple[Contact, ...]) -> Floats:
    """Return [A B] = one + b level + r residual + b r both (4, states, states and inputs), as in
    `Coefficient`, of all rates, with a column for the friction force of each contact.
    """
    names = states + plan.inputs
    accelerations = {
        f"{body.name}_velocity": body.force / body.mass_kg for body in plan.bodies.values()
    }
    rates = {**plan.rates, **accelerations}
    cells = np.array([[rates[row].terms.get(name, ZERO) for name in names] for row in states])
    found = np.zeros((4, len(states), len(names) + len(contacts)))
    found[:, :, : len(names)] = np.moveaxis(cells, -1, 0)
    for contact in contacts:  # friction acts on a mass alone: neither level nor resistance
        column = len(states) + contact.column
        found[0, contact.velocity, column] = 1.0 / plan.bodies[contact.body].mass_kg
    return found


def _contacts(plan: Blueprint, states: list[str]) -> tuple[Contact, ...]:
    rubbing = [body for body in plan.bodies.values() if body.coulomb_n > 0.0]
    return tuple(
        Contact(
            body.name,
            states.index(f"{body.name}_velocity"),
            states.index(f"{body.name}_position"),
            body.coulomb_n,
            len(plan.inputs) + place,
        )
        for place, body in enumerate(rubbing)
    )


def _outputs(plan: Blueprint, states: list[str], width: int) -> Outputs:
    def output(form: Form) -> Output:
        of_states = np.zeros((2, len(states)))  # constant part, and part proportional to the level
        of_inputs = np.zeros((2, width))
        for name, c in form.terms.items():
            at = (c.one + plan.residual_ohm * c.residual, c.level + plan.residual_ohm * c.both)
            if name in states:
                of_states[:, states.index(name)] = at
            else:
                of_inputs[:, plan.inputs.index(name)] = at
        return Output(*(frozen(row) for row in (*of_states, *of_inputs)))

    rotor = plan.rotor
    return Outputs(
        encoder=output(plan.endpoint.position),
        position=output(rotor.position),
        velocity=output(rotor.velocity),
        recorded_velocity=output(plan.channel),
        recorded_travel=output(plan.travel),
        recorded_impulse=None if plan.impulse is None else output(plan.impulse),
        motor_force=output(plan.motor),
        estimate=output(plan.estimate),
    )


def _ends(plan: Blueprint, states: list[str]) -> Ends | None:
    if plan.ends_m is None:
        return None
    name = plan.endpoint.name
    return Ends(*plan.ends_m, states.index(f"{name}_position"), states.index(f"{name}_velocity"))


def _drive(plan: Blueprint, states: list[str]) -> DriveLimits | None:
    """Return the limits in newtons at the endpoint, with the winding's resistance at the start."""
    given = plan.amplifier_range
    if given is None or plan.amplifier_rad_s is None:
        return None
    n_per_a = plan.torque_constant_n_per_a
    around_ohm = plan.resistance_ohm + given.series_ohm
    return DriveLimits(
        motor_force=states.index("motor_force"),
        velocity=states.index("rotor_velocity"),
        limit_n=n_per_a * given.current_a,
        stall_n=n_per_a * given.voltage_v / around_ohm,
        shorted_ns_per_m=n_per_a**2 / around_ohm,
        electrical_rad_s=around_ohm / given.inductance_h,
        amplifier_rad_s=plan.amplifier_rad_s,
    )


# --- numbers of board.json ------------------------------------------------------------------------

GRID = 21  # damping levels from 0 to the highest
RESIDUALS = 9  # residual resistances, when the winding heats up
TRIMMED_RESIDUALS = 33  # the same, if the host compensates it as well
HOTTEST_C = 180.0  # upper end of that axis
FAR_M = 1e3  # where a device without ends would stop; JSON has no infinity


def plant_params(
    model: Model,
    duration_s: float,
    exact_levels: Iterable[float],
    highest_ns_per_m: float,
    trim_ohm: float = 0.0,
) -> PlantParams:
    """Return tables of `model` for sub-steps of `duration_s`, up to `highest_ns_per_m`, for a board
    that compensates at most `trim_ohm` beyond the nominal.

    They are exact at `exact_levels` [Ns/m], which are rounded to counts as the DAC rounds them.
    """
    quantum = model.active_damping_quantum_ns_per_m
    levels = {float(level) for level in np.linspace(0.0, highest_ns_per_m, GRID)}
    levels |= {
        level if quantum is None else floor(level / quantum + 0.5) * quantum
        for level in exact_levels
    }
    residuals = _residuals(model, trim_ohm)
    variants = [
        model.at_residual(residual_ohm) if model.winding else model for residual_ohm in residuals
    ]
    maps = [
        discretise(variant, duration_s, level) for variant in variants for level in sorted(levels)
    ]
    if model.drive is not None:
        for one in maps:  # each must be able to limit the force
            drive_response_s(model.drive, model.inputs.amplifier, one)
    out = model.outputs
    return PlantParams(
        states=tuple(state.name for state in model.states),
        columns=_columns(model),
        floating=model.drifts(),
        levels_ns_per_m=tuple(sorted(levels)),
        residuals_ohm=residuals,
        maps=tuple(tuple(np.hstack([found.a, found.b]).ravel().tolist()) for found in maps),
        encoder=out.encoder.params(),
        travel=out.recorded_travel.params(),
        impulse=None if out.recorded_impulse is None else out.recorded_impulse.params(),
        motor_force=out.motor_force.params(),
        estimate=out.estimate.params(),
        contacts=model.contacts,
        ends=model.ends,
        rotor_forces=model.rotor_forces,
        drive=model.drive,
        noise=model.noise,
        estimate_offset_m_per_s=model.estimate_offset_m_per_s,
        heating=None if model.winding is None else model.winding.heating,
    )


def board_fields(
    model: Model,
    exact_levels: Iterable[float],
    highest_ns_per_m: float,
    trim_ohm: float = 0.0,
) -> dict[str, Any]:
    """Return the fields of BoardParams that describe `model`; arguments as for `plant_params`.

    They are the tables, and the values of a rigid mass that firmware and pages show.
    """
    substep_s = 1.0 / (SUBSTEPS_PER_TICK * model.rate_hz)
    return {
        "mass_kg": model.mass_kg,
        "viscous_ns_per_m": model.viscous_ns_per_m,
        "lower_stop_m": model.ends.lower_m if model.ends else -FAR_M,
        "upper_stop_m": model.ends.upper_m if model.ends else FAR_M,
        "torque_constant_n_per_a": model.torque_constant_n_per_a,
        "winding_ohm": model.resistance_ohm,
        "ambient_c": model.temperature_c,
        "plant": plant_params(model, substep_s, [0.0, *exact_levels], highest_ns_per_m, trim_ohm),
    }


def _columns(model: Model) -> tuple[str, ...]:
    inputs = asdict(model.inputs)
    del inputs["width"]
    names = {column: name for name, column in inputs.items() if column is not None}
    names |= {contact.column: f"friction_{contact.body}" for contact in model.contacts}
    return tuple(names[column] for column in range(model.inputs.width))


def _residuals(model: Model, trim_ohm: float) -> tuple[float, ...]:
    if model.winding is None:
        return (model.residual_ohm,)
    winding = model.winding.heating
    low, high = (
        copper_ohm(winding.resistance_ohm, winding.reference_c, end_c) - winding.compensated_ohm
        for end_c in (min(winding.start_c, winding.ambient_c), HOTTEST_C)
    )
    count = TRIMMED_RESIDUALS if trim_ohm else RESIDUALS
    return tuple(float(residual_ohm) for residual_ohm in np.linspace(low - trim_ohm, high, count))
