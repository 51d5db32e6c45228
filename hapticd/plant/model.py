"""A composed model: what is left of a scene's device once every effect has said what it adds. Frozen values, no behaviour.

    x' = A(b) x + B(b) u            A(b) = a0 + b a1,  B(b) = b0 + b b1,  b = commanded damping level, Ns/m, >= 0
    y  = C(b) x + D(b) u            for every Output

`b` is the level after its DAC: gain and scale errors of the multiplier are already inside a1 and a0. A residual winding
resistance dR (true minus compensated, ohm) is inside as well, as rho = dR / K^2 [m/s per N] on the velocity estimate, which
scales command and damping by alpha = 1 / (1 + b rho); with a `Winding` it varies and `at_residual` gives the model there.

Columns of u, by name in `Inputs` (absent ones are None):
    command   virtual force [N], held by the DAC; the value of tick k acts from (k + delay_periods) T to (k + 1 + delay_periods) T
    torque    perturbation of the probe, as endpoint force [N]
    estimate  error of the velocity estimate [m/s]: multiplier offset (constant, `estimate_offset_m_per_s`) and noise
    rotor_force  what acts on the rotor and is not linear in its position and velocity [N]
    each Contact brings its own column

Everything that is not linear stands beside it, present or None: None means that no instruction is spent on it.

What would break it: changing an array (they are read-only), or a level from before the DAC's quantisation.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hapticd.params import Contact, Ends, Noise, RotorForce
from hapticd.plant.blueprint import InputColumns, Note, StateVariable

__all__ = [
    "Array", "Contact", "Ends", "InputColumns", "Map", "Model", "Noise", "Note", "Output",
    "Outputs", "RotorForce", "StateVariable", "Winding",
]  # fmt: skip

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Winding:
    """Copper loss heats the winding, and its resistance grows (0.393 %/K):

    dT/dt = (R(T) (F/K)^2 R_th - (T - ambient)) / tau;  dR(T) = resistance_ohm (1 + 0.00393 (T - reference_c)) - compensated.
    `a0, a1, b0, b1` are the changes of the model's arrays per ohm of residual dR.
    """

    resistance_ohm: float  # at reference_c
    reference_c: float
    compensated_ohm: float
    residual_ohm: float  # at which the model's own arrays hold
    thermal_resistance_k_per_w: float
    time_constant_s: float
    ambient_c: float
    start_c: float
    a0: Array
    a1: Array
    b0: Array
    b1: Array


@dataclass(frozen=True, eq=False)
class Output:
    """y = (c0 + b c1) x + (d0 + b d1) u: c0, c1 (states,), d0, d1 (inputs,)."""

    unit: str
    c0: Array
    c1: Array
    d0: Array
    d1: Array

    def row(self, damping_ns_per_m: float = 0.0) -> Array:
        """(states,)"""
        return self.c0 + damping_ns_per_m * self.c1

    def through(self, damping_ns_per_m: float = 0.0) -> Array:
        """(inputs,)"""
        return self.d0 + damping_ns_per_m * self.d1


@dataclass(frozen=True, eq=False)
class Outputs:
    """What can be seen of the device.

    The 4 kHz record holds means over its intervals h: velocity = [recorded_travel(end) - recorded_travel(start)] / h, torque
    = mean of the held torque + [recorded_impulse(end) - recorded_impulse(start)] / h. `recorded_velocity` is the same channel
    at an instant. Without high-pass and anti-alias filters recorded_travel is the probe's position and recorded_impulse None.
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
    delay_periods: float  # from the encoder sample to the command that it leads to, without the hold
    states: tuple[StateVariable, ...]
    a0: Array
    a1: Array
    b0: Array
    b1: Array
    inputs: InputColumns
    outputs: Outputs
    contacts: tuple[Contact, ...] = ()  # at most two, on different bodies
    encoder_quantum_m: float | None = None
    force_quantum_n: float | None = None
    force_limit_n: float | None = None
    damping_quantum_ns_per_m: float | None = None
    ends: Ends | None = None
    rotor_forces: tuple[RotorForce, ...] = ()
    noise: Noise | None = None
    winding: Winding | None = None
    estimate_offset_m_per_s: float = 0.0  # constant on Inputs.estimate
    level_gain: float = 1.0  # the circuit is asked for level_gain b + level_offset_ns_per_m
    level_offset_ns_per_m: float = 0.0
    mass_kg: float = 0.0  # all that moves with the endpoint, the probe included
    probe_mass_kg: float = 0.0
    viscous_ns_per_m: float = 0.0  # all viscous friction, at both bodies
    coulomb_n: float = 0.0  # all Coulomb friction
    velocity_quantum_m_per_s: float | None = None  # of the recorded velocity
    torque_quantum_n: float | None = None  # of the perturbation
    torque_constant_n_per_a: float = 1.0  # K_m / lever radius
    resistance_ohm: float = 0.0  # of the winding as it is
    temperature_c: float = 20.0  # of the winding, at the start
    residual_ohm: float = 0.0  # that the damping circuit does not cancel
    notes: tuple[Note, ...] = ()

    def a(self, damping_ns_per_m: float = 0.0) -> Array:
        """A at that level, (n, n)."""
        return self.a0 + damping_ns_per_m * self.a1

    def b(self, damping_ns_per_m: float = 0.0) -> Array:
        """B at that level, (n, m)."""
        return self.b0 + damping_ns_per_m * self.b1

    def index(self, state: str) -> int:
        """Index of the state of that name. ValueError if the model has none."""
        return [item.name for item in self.states].index(state)

    def at_residual(self, residual_ohm: float) -> "Model":
        """The same device with another residual resistance, a colder or hotter winding. Needs a `winding`."""
        if self.winding is None:
            raise ValueError(f"model {self.name!r} has no winding whose resistance changes")
        w, change = self.winding, residual_ohm - self.winding.residual_ohm
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
    """Exact response over `duration_s` to inputs that are held: x' = a x + b u; a (n, n), b (n, m)."""

    duration_s: float
    damping_ns_per_m: float
    a: Array
    b: Array
