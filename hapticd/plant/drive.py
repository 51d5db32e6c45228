"""The loop of the damping circuit (Weir 2008, Fig. 6): estimate, multiplier, amplifier, force on the rotor.

    F_r'   = w_r (F_cmd - F_r)                                   smoothing of the command
    F_a'   = w_a (F_r - g(b) (v_hat + e) - F_a)                  current amplifier, motor force as endpoint force
    v_hat' = w_d (v_rotor + (dR / K^2) F_a + (dL / K^2) F_a' - v_hat)     Eq. 6: (V - R i - L di/dt) / K_emf, i = F_a / K
    `shaped_damping`, where there is one, stands between v_hat and g(b)
    g(b)   = (1 + gain error) b + scale offset;  e = offset and noise of the estimate
b is the commanded damping in Ns/m, K = K_m / r the force per ampere at the endpoint, dR and dL what the circuit leaves of
resistance and inductance uncancelled. At DC F_a = alpha (F_r - g v) with alpha = 1 / (1 + g dR / K^2): a hot winding makes
damping AND force weaker; over-compensation makes both stronger until the circuit oscillates at g dR / K^2 = -1. The
inductance error must stay above -(1 / w_a + 1 / w_d) K^2 / g.

What would break it: resistance or inductance errors without the lags that make the loop a differential equation (refused).
"""

from hapticd.errors import ConfigError
from hapticd.plant.blueprint import Blueprint
from hapticd.plant.electrical import Amplifier, DampingCircuit
from hapticd.plant.forms import Form
from hapticd.plant.shaped_damping import ShapedDamping, shaped


def drive(plan: Blueprint) -> None:
    """Close the loop: estimate, multiplier, amplifier, force on the rotor. ConfigError if a lag is missing or in excess."""
    rotor = plan.rotor
    if plan.crowbar:
        _short(plan)
        return
    _refuse_algebraic(plan)
    lagging, filtered = plan.amplifier_rad_s, plan.circuit_rad_s
    motor = plan.state("motor_force", "N", Amplifier.key) if lagging else None
    estimate = plan.state("velocity_estimate", "m/s", DampingCircuit.key) if filtered else None
    if estimate is None:
        estimate = rotor.velocity + (Form() if motor is None else _left_by_resistance(plan, motor))
    asked = plan.command - _multiplied(plan, shaped(plan, estimate))
    if lagging and motor is not None:
        plan.rates["motor_force"] = lagging * (asked - motor)
    else:
        motor = asked
    if filtered:
        source = rotor.velocity + _left_by_resistance(plan, motor)
        if plan.inductance_error_h:
            source += (plan.inductance_error_h / plan.torque_constant_n_per_a**2) * plan.rates["motor_force"]
        plan.rates["velocity_estimate"] = filtered * (source - estimate)
    plan.motor, plan.estimate = motor, estimate
    rotor.force += motor


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


def _short(plan: Blueprint) -> None:
    if plan.amplifier_rad_s or plan.circuit_rad_s or plan.inductance_error_h or any(plan.shaping_rad_s):
        raise ConfigError(
            f"a crowbar shorts the motor: leave out 'amplifier', 'damping_circuit', {ShapedDamping.key!r} and 'inductance'"
        )
    damping = plan.torque_constant_n_per_a**2 / plan.resistance_ohm
    plan.motor = -damping * plan.rotor.velocity
    plan.estimate = plan.rotor.velocity
    plan.rotor.force += plan.motor
