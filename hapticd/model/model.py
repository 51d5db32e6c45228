"""A composed model: the result of all effects of a scene's device. Frozen values, no behaviour.

    x' = A(b) x + B(b) u        A(b) = a0 + b a1,  B(b) = b0 + b b1,  b >= 0 damping level, Ns/m
    y  = C(b) x + D(b) u        for every Output

`b` is the level after its DAC: a1 and a0 include gain and scale errors of the multiplier. They also
include a residual winding resistance dR (true minus compensated, ohm), as rho = dR / K^2 [m/s per
N] on the velocity estimate, which scales command and damping by alpha = 1 / (1 + b rho). With a
`Winding` it varies, and `at_residual` gives the model there.

Columns of u, by name in `InputColumns` (absent ones are None):

    command      virtual force [N], held by the DAC; the value of tick k acts for one period from
                 (k + delay_periods) T on
    torque       perturbation of the probe, as endpoint force [N]
    estimate     error of the velocity estimate [m/s]: offset of the multiplier (constant,
                 `estimate_offset_m_per_s`) and noise
    rotor_force  force on the rotor that is not linear in its position and velocity [N]
    amplifier    change of the motor force's rate by the limits of the amplifier [N/s]
    each Contact has a column of its own

Every nonlinear part is a field of its own, present or None; None costs no instruction.

Arrays must not be changed (they are read-only), and a level must be that after the DAC's
quantisation.
"""

from dataclasses import dataclass, replace

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.model.blueprint import InputColumns, Note, StateVariable
from hapticd.model.params import (
    Contact,
    DriveLimits,
    Ends,
    HeatingParams,
    Noise,
    OutputParams,
    RotorForce,
)

__all__ = [
    "Contact",
    "DriveLimits",
    "Ends",
    "Map",
    "Model",
    "Noise",
    "Output",
    "Outputs",
    "RotorForce",
    "StateVariable",
    "Winding",
    "frozen",
]


def frozen(array: Floats) -> Floats:
    """Return a read-only copy."""
    copy = np.array(array, dtype=np.float64)
    copy.flags.writeable = False
    return copy


@dataclass(frozen=True, eq=False)
class Winding:
    """Copper loss heats the winding, and its resistance grows (0.393 %/K).

        dT/dt = (R(T) (F / K)^2 R_th - (T - ambient)) / tau
        R(T)  = resistance_ohm (1 + 0.00393 (T - reference_c)),   dR = R(T) - compensated_ohm

    The numbers are those of `heating`; `a0, a1, b0, b1` are the changes of the model's arrays per
    ohm of dR.
    """

    heating: HeatingParams
    residual_ohm: float  # at which the model's own arrays hold
    a0: Floats  # (n, n) per ohm, as all four
    a1: Floats  # per Ns/m as well
    b0: Floats  # (n, m)
    b1: Floats  # per Ns/m as well


@dataclass(frozen=True, eq=False)
class Output:
    """y = (c0 + b c1) x + (d0 + b d1) u: c0, c1 (states,), d0, d1 (inputs,)."""

    c0: Floats  # (states,)
    c1: Floats  # (states,), per Ns/m
    d0: Floats  # (inputs,)
    d1: Floats  # (inputs,), per Ns/m

    def row(self, active_damping_ns_per_m: float = 0.0) -> Floats:
        """C at that level, (states,)."""
        return self.c0 + active_damping_ns_per_m * self.c1

    def through(self, active_damping_ns_per_m: float = 0.0) -> Floats:
        """D at that level, (inputs,)."""
        return self.d0 + active_damping_ns_per_m * self.d1

    def params(self) -> OutputParams:
        """The same as plain numbers."""
        rows = (self.c0, self.c1, self.d0, self.d1)
        return OutputParams(*(tuple(row.tolist()) for row in rows))


@dataclass(frozen=True, eq=False)
class Outputs:
    """The measurable outputs of the device.

    The 4 kHz record holds means over its intervals h:

        velocity = [recorded_travel(end) - recorded_travel(start)] / h
        torque   = mean of the held torque + [recorded_impulse(end) - recorded_impulse(start)] / h

    `recorded_velocity` is the same channel at an instant. Without high-pass and anti-alias filters
    recorded_travel is the probe's position and recorded_impulse None.
    """

    encoder: Output  # m, before quantisation; not on the motor in a two-mass device
    position: Output  # m, of the rotor and probe
    velocity: Output  # m/s, of the rotor and probe: the true one
    recorded_velocity: Output  # m/s
    recorded_travel: Output  # m
    recorded_impulse: Output | None  # N s
    motor_force: Output  # N at the endpoint; current = motor_force / torque_constant_n_per_a
    estimate: Output  # m/s, back-EMF velocity estimate of the damping circuit


@dataclass(frozen=True, eq=False)
class Model:
    """The composed model. n states, m inputs: a0, a1 (n, n); b0, b1 (n, m), float64, read-only."""

    name: str
    rate_hz: float  # of the servo; T = 1 / rate_hz
    delay_periods: float  # from the encoder sample to its command, without the hold
    states: tuple[StateVariable, ...]  # n of them
    a0: Floats  # (n, n), 1/s and the like, by the units of the states
    a1: Floats  # (n, n), per Ns/m of damping level
    b0: Floats  # (n, m)
    b1: Floats  # (n, m), per Ns/m
    inputs: InputColumns
    outputs: Outputs
    contacts: tuple[Contact, ...] = ()  # at most two, on different bodies
    # one count; None for no rounding, as for the other quanta
    encoder_quantum_m: float | None = None
    force_quantum_n: float | None = None  # one count of the force DAC
    force_limit_n: float | None = None  # largest magnitude of the command; None for no limit
    active_damping_quantum_ns_per_m: float | None = None  # one count of the damping DAC
    ends: Ends | None = None  # mechanical ends of travel
    # nonlinear ones; at most columns of Inputs.rotor_force
    rotor_forces: tuple[RotorForce, ...] = ()
    drive: DriveLimits | None = None  # limits of the amplifier; columns of Inputs.amplifier
    noise: Noise | None = None  # of velocity channel and velocity estimate
    winding: Winding | None = None  # None: the winding keeps its temperature
    estimate_offset_m_per_s: float = 0.0  # constant on Inputs.estimate
    level_gain: float = 1.0  # level of the circuit: level_gain b + level_offset_ns_per_m
    level_offset_ns_per_m: float = 0.0  # of the multiplier
    mass_kg: float = 0.0  # total moving mass, the probe included
    probe_mass_kg: float = 0.0  # part of mass_kg
    viscous_ns_per_m: float = 0.0  # all viscous friction, at both bodies
    velocity_quantum_m_per_s: float | None = None  # of the recorded velocity
    torque_quantum_n: float | None = None  # of the perturbation
    torque_constant_n_per_a: float = 1.0  # K_m / lever radius
    resistance_ohm: float = 0.0  # true value of the winding
    temperature_c: float = 20.0  # of the winding, at the start
    residual_ohm: float = 0.0  # that the damping circuit does not cancel
    notes: tuple[Note, ...] = ()  # descriptions of the effects

    def a(self, active_damping_ns_per_m: float = 0.0) -> Floats:
        """A at that level, (n, n)."""
        return self.a0 + active_damping_ns_per_m * self.a1

    def b(self, active_damping_ns_per_m: float = 0.0) -> Floats:
        """B at that level, (n, m)."""
        return self.b0 + active_damping_ns_per_m * self.b1

    def translation(self) -> Floats:
        """All bodies moved by the same amount: 1 for every position, 0 otherwise, (n,)."""
        return np.array([1.0 if state.name.endswith("_position") else 0.0 for state in self.states])

    def drifts(self, active_damping_ns_per_m: float = 0.0) -> bool:
        """Whether the device itself does not hold its position."""
        return not (self.a(active_damping_ns_per_m) @ self.translation()).any()

    def at_residual(self, residual_ohm: float) -> "Model":
        """Return the same device with another residual resistance, that of a colder or hotter
        winding. ValueError if the model has no `winding`.
        """
        if self.winding is None:
            raise ValueError(f"model {self.name!r} has no winding whose resistance changes")
        w = self.winding
        change = residual_ohm - self.winding.residual_ohm
        return replace(
            self,
            a0=self.a0 + change * w.a0,
            a1=self.a1 + change * w.a1,
            b0=self.b0 + change * w.b0,
            b1=self.b1 + change * w.b1,
            resistance_ohm=self.resistance_ohm + residual_ohm - self.residual_ohm,
            residual_ohm=residual_ohm,
            winding=replace(w, residual_ohm=residual_ohm),
        )


@dataclass(frozen=True, eq=False)
class Map:
    """Exact response over a step to held inputs: x' = a x + b u."""

    duration_s: float  # of the step
    active_damping_ns_per_m: float  # damping level that it holds for
    a: Floats  # (n, n)
    b: Floats  # (n, m)
