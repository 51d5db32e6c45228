"""Every effect that a simulated device can have, one class each, in the order of composition.

An effect is one table of a device file ([model.KEY]) and a frozen value. It contains its purpose,
the sources of its numbers, and its terms of the equations. Its parameters are its fields, with the
unit in the name. Every number has one of three tags: paper (printed by Weir, Colgate and Peshkin
2008), inferred (from other known facts or good practice), calibrated (fitted so that the device
reproduces the paper's limits). The catalogue (`KINDS`, at the end) lists the classes in the order
of the text. A scene selects an effect by its `key`; those in `ALWAYS` are always built.

Bodies: one mass or two, their friction, and the parts attached at either end.

    m_r v_r' = -k (x_r - x_s) - b (v_r - v_s) - b_r v_r + F_motor + F_probe + F_cogging - Coulomb
    m_s v_s' =  k (x_r - x_s) + b (v_r - v_s) - b_s v_s + F_load + F_hand              - Coulomb

Everything is reflected to the endpoint (N, m, kg, Ns/m). The encoder is on the slider; motor, probe
and velocity coil are on the rotor: not colocated (Weir 2008, section 2.1). Without `Coupling` the
two are one mass, and all forces act on it.

Electronics: transport, converter, smoothing, amplifier and damping circuit lie between the force
command and the motor force. Each leaves its number in the blueprint; `compose` writes the equations
of the loop. The winding determines current and power per newton, and how heat impairs the
resistance compensation:

    R(T) = R_0 (1 + 0.00393 (T - T_0))     copper (the paper prints "percent"; 0.393 %/K is meant)
    T'   = (R(T) (F / K)^2 R_th - (T - T_ambient)) / tau
    dR   = R(T) - R_compensated            the residual that stays in the velocity estimate

Shaped damping is a filter between the velocity estimate and the multiplier of the damping circuit:

    Z_added(s) = b H(s),   H(s) = s / (s + w_l) * w_h / (s + w_h)     either factor may be left out

"Future work could address a frequency dependent active damping, since added mechanical dissipation
is rarely needed at low frequency" (Weir, Colgate and Peshkin 2008, section 6; Brown 1995). In
mechanical terms the high-pass puts a free mass b / w_l in series with the damper b, the low-pass a
spring b w_h. A chain of passive elements is passive, so the shaped damper alone is passive:

    high-pass  Re Z = b w^2 / (w^2 + w_l^2)        low-pass  Re Z = b w_h^2 / (w^2 + w_h^2)
    both       Re Z = b w_h w^2 (w_l + w_h) / ((w_l w_h - w^2)^2 + w^2 (w_l + w_h)^2)

w_l -> 0 and w_h -> infinity give the plain damper, w_l -> infinity and w_h -> 0 remove it. A
high-pass also keeps the estimate's error from a hot winding out of the static force: alpha is 1 at
DC.

Sensing: the servo's encoder, and the probe's 4 kHz record of torque and velocity. A record holds
means over its 250 us, so that the sum of torque x velocity x 250 us is the exact work. The mean of
a filtered channel needs no extra state: a first-order high-pass y = v - h, h' = w (v - h) has the
integral h / w, and a second-order low-pass y'' + 2 zeta w y' + w^2 y = w^2 u has the integral of u
minus (y' + 2 zeta w y) / w^2. These integrals are `travel` (of velocity) and `impulse` (the part of
the torque that the filter retains).

An effect must be written after those whose signals it uses. A low-pass of the shaped damping must
not be combined with the circuit's own bandwidth w_d. Two lags in series reverse the sign of damping
above sqrt(w_h w_d), and there the shaped damper is active; a high-pass and one lag never do that.
"""

from collections.abc import Callable, Iterable
from dataclasses import MISSING, dataclass, field, fields
from math import floor, sqrt, tau
from typing import Any, ClassVar, NamedTuple, TypeVar, dataclass_transform

from hapticd.core.units import COPPER_PER_K, unit_of
from hapticd.model.blueprint import (
    AmplifierRange,
    Blueprint,
    Copper,
    Form,
    Note,
    Parameter,
)
from hapticd.model.params import HeatingParams

__all__ = [
    "ALWAYS",
    "BY_KEY",
    "PROVENANCE",
    "Delay",
    "Effect",
    "Encoder",
    "Masses",
    "Motor",
    "Saturation",
    "ShapedDamping",
    "Smoothing",
    "Viscous",
    "WindingTemperature",
    "copper_ohm",
    "sample_timing",
]

PROVENANCE = ("source", "sources", "note")  # fields of every effect that are not parameters
ZETA = sqrt(0.5)  # damping ratio of a Butterworth low-pass of the second order


def number(default: Any = MISSING, **limits: float) -> Any:
    """Declare a parameter with its range: gt, ge, lt, le, enforced where files are read."""
    return field(default=default, metadata=limits)


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """Base of every effect: its purpose, the sources of its numbers, its equations."""

    key: ClassVar[str]  # table name in a device file: [model.KEY]
    why: ClassVar[str]  # one sentence for `hapticd sim explain`
    nonlinearity: ClassVar[str] = ""  # its nonlinearity; empty for a linear effect

    # paper | inferred | calibrated, for every parameter not named in `sources`
    source: str = "inferred"
    sources: tuple[tuple[str, str], ...] = ()  # (parameter, tag) where the tag differs
    note: str = ""  # remark on the source

    def build(self, plan: Blueprint) -> None:
        """Write states, forces, signals or nonlinearities into `plan`."""
        raise NotImplementedError

    def time_constants_s(self) -> tuple[float, ...]:
        """Time constants of the effect alone, from its corners and bandwidths. Those of the whole
        device are eigenvalues of the model.
        """
        values = {one.name: one.value for one in self.parameters()}
        corners = [value for name, value in values.items() if name.endswith("_hz") and value]
        return tuple(1.0 / (tau * corner_hz) for corner_hz in corners)

    def parameters(self) -> tuple[Parameter, ...]:
        """Every number with its unit and its source."""
        tags = dict(self.sources)
        names = [item.name for item in fields(self) if item.name not in PROVENANCE]
        return tuple(
            Parameter(name, getattr(self, name), unit_of(name), tags.get(name, self.source))
            for name in names
        )

    def note_of(self, states: tuple[str, ...]) -> Note:
        """Describe the effect, with the names of the states that it added."""
        why = f"{self.why}; {self.note}" if self.note else self.why
        return Note(
            self.key, why, states, self.nonlinearity, self.time_constants_s(), self.parameters()
        )


E = TypeVar("E", bound=Effect)


@dataclass_transform(frozen_default=True, kw_only_default=True)
def effect(key: str, why: str, nonlinearity: str = "") -> Callable[[type[E]], type[E]]:
    """Return the decorator of an effect: a frozen dataclass with these attributes of `Effect`."""

    def made(kind: type[E]) -> type[E]:
        kind.key = key
        kind.why = why
        kind.nonlinearity = nonlinearity
        return dataclass(frozen=True, slots=True, kw_only=True)(kind)

    return made


# --- bodies and attachments -----------------------------------------------------------------------


@effect("masses", "the moving masses")
class Masses(Effect):
    """The masses themselves. They are always built."""

    rotor_kg: float = number(gt=0, le=100)  # moving with the motor, reflected to the endpoint
    slider_kg: float = number(0.0, ge=0, le=100)  # sliding with the encoder

    def build(self, plan: Blueprint) -> None:
        """One rigid body; `Coupling` splits it."""
        rotor = plan.body("rotor", self.rotor_kg + self.slider_kg, self.key)
        plan.slider_kg = self.slider_kg
        plan.travel = rotor.position
        plan.channel = rotor.velocity


@effect("probe", "the probe moves with the rotor while it measures")
class ProbeMass(Effect):
    """The Z-width probe on the rotor: its inertia.

    Its torque input and velocity output exist on every device.
    """

    mass_kg: float = number(ge=0, le=100)  # added to the rotor while the probe is mounted

    def build(self, plan: Blueprint) -> None:
        """Make the rotor heavier."""
        plan.rotor.mass_kg += self.mass_kg
        plan.probe_mass_kg = self.mass_kg


@effect("coupling", "the encoder is not on the motor: a mode above 300 Hz between the two")
class Coupling(Effect):
    """A flexible transmission between rotor and slider."""

    stiffness_n_per_m: float = number(gt=0, le=1e9)  # of the transmission, seen at the endpoint
    # of the transmission, relative to the motion of the slider
    damping_ns_per_m: float = number(ge=0, le=1e5)

    def build(self, plan: Blueprint) -> None:
        """Take the slider off the rotor and hold it by a spring and a damper."""
        rotor = plan.rotor
        rotor.mass_kg -= plan.slider_kg
        slider = plan.body("slider", plan.slider_kg, self.key)
        stretch = rotor.position - slider.position
        rate = rotor.velocity - slider.velocity
        held = self.stiffness_n_per_m * stretch + self.damping_ns_per_m * rate
        rotor.force -= held
        slider.force += held


@effect("viscous", "physical damping: the budget that sampling and delay spend")
class Viscous(Effect):
    """Friction proportional to velocity, at either body."""

    rotor_ns_per_m: float = number(ge=0, le=1e5)  # between rotor and ground
    slider_ns_per_m: float = number(0.0, ge=0, le=1e5)  # between slider and ground

    def build(self, plan: Blueprint) -> None:
        """Add -b v to the force on each body."""
        for body, level in (
            (plan.rotor, self.rotor_ns_per_m),
            (plan.endpoint, self.slider_ns_per_m),
        ):
            body.force -= level * body.velocity
            plan.viscous_ns_per_m += level


@effect("load", "something is mounted at the endpoint")
class Load(Effect):
    """Mass, spring and damper against ground, fixed to the endpoint."""

    mass_kg: float = number(0.0, ge=0, le=100)  # moves with the endpoint
    damping_ns_per_m: float = number(0.0, ge=0, le=1e5)  # against ground
    stiffness_n_per_m: float = number(0.0, ge=0, le=1e8)  # against ground, free at position 0

    def build(self, plan: Blueprint) -> None:
        """Add mass and force to the endpoint."""
        end = plan.endpoint
        end.mass_kg += self.mass_kg
        end.force -= self.damping_ns_per_m * end.velocity + self.stiffness_n_per_m * end.position


@effect("hand", "a person holds the endpoint")
class PassiveHand(Effect):
    """A passive human: a finger mass on the arm's spring and damper, held through the finger pad.
    All parameters are 0 or more, therefore passive (Colgate and Schenkel 1997 need no more of a
    human).
    """

    mass_kg: float = number(gt=0, le=100)  # of the finger
    damping_ns_per_m: float = number(ge=0, le=1e5)  # of the arm, against ground
    stiffness_n_per_m: float = number(ge=0, le=1e8)  # of the arm, against ground
    # of the finger pad, between endpoint and finger
    grip_stiffness_n_per_m: float = number(ge=0, le=1e8)
    grip_damping_ns_per_m: float = number(ge=0, le=1e5)  # of the finger pad

    def build(self, plan: Blueprint) -> None:
        """Add a body of its own, coupled to the endpoint."""
        end = plan.endpoint
        hand = plan.body("hand", self.mass_kg, self.key)
        grip = self.grip_stiffness_n_per_m * (end.position - hand.position)
        grip += self.grip_damping_ns_per_m * (end.velocity - hand.velocity)
        end.force -= grip
        hand.force += (
            grip - self.damping_ns_per_m * hand.velocity - self.stiffness_n_per_m * hand.position
        )


@effect(
    "cogging",
    "iron in the stator pulls the magnets to preferred positions",
    "force periodic in position",
)
class MagnetCogging(Effect):
    """Torque of the magnets on the iron, periodic in rotor position."""

    amplitude_n: float = number(ge=0, le=100)  # peak force at the endpoint
    pitch_m: float = number(gt=0, le=1)  # travel of one period
    phase_rad: float = number(0.0, ge=-7, le=7)  # at position 0

    def build(self, plan: Blueprint) -> None:
        """Add a force input that both backends compute with the law `sine`."""
        plan.rotor_force("sine", self.amplitude_n, self.pitch_m, self.phase_rad)


@effect("ends", "the travel has ends", "position held inside the travel")
class WorkspaceEnds(Effect):
    """Inelastic mechanical ends at the endpoint."""

    lower_m: float = number(ge=-10, le=10)  # lowest position of the endpoint
    upper_m: float = number(ge=-10, le=10)  # highest position of the endpoint

    def build(self, plan: Blueprint) -> None:
        """Set the ends of travel; both backends keep the endpoint inside."""
        plan.ends_m = (self.lower_m, self.upper_m)


# --- dry friction ---------------------------------------------------------------------------------


@effect(
    "coulomb",
    "dry friction: most of the undamped device's damping, and more of it when motion is small",
    "set-valued force, stick at v = 0",
)
class Coulomb(Effect):
    """Dry friction at either body."""

    rotor_n: float = number(ge=0, le=100)  # level Fc at the rotor
    slider_n: float = number(0.0, ge=0, le=100)  # level Fc at the slider

    def build(self, plan: Blueprint) -> None:
        """Add the level to each body; a body with friction becomes a contact."""
        plan.rotor.coulomb_n += self.rotor_n
        plan.endpoint.coulomb_n += self.slider_n


# --- from the force command to the motor force, and the damping circuit ---------------------------


@effect("delay", "computing and transport take time")
class Delay(Effect):
    """The time from an encoder sample to the force computed from it."""

    periods: float = number(ge=0, le=10)  # of the servo; may be fractional and more than 1

    def build(self, plan: Blueprint) -> None:
        """Set the delay of the command."""
        plan.delay_periods = self.periods


@effect("force_dac", "the torque command is a count", "force rounded to a count")
class ForceDac(Effect):
    """The converter of the torque command."""

    quantum_n: float = number(gt=0)  # endpoint force of one count

    def build(self, plan: Blueprint) -> None:
        """Set the force of one count."""
        plan.numbers["force_quantum_n"] = self.quantum_n


@effect(
    "saturation",
    "motor and amplifier have a maximum force; it bounds an unstable motion",
    "force held inside its limit",
)
class Saturation(Effect):
    """The force command is limited."""

    limit_n: float = number(gt=0)  # largest magnitude of the command

    def build(self, plan: Blueprint) -> None:
        """Set the limit."""
        plan.numbers["force_limit_n"] = self.limit_n


@effect(
    "smoothing",
    "reconstruction filter behind the torque DAC: lag of the virtual force at low frequency",
)
class Smoothing(Effect):
    """First-order low-pass on the virtual-force command alone, not on the damping."""

    corner_hz: float = number(gt=0, le=1e6)  # -3 dB

    def build(self, plan: Blueprint) -> None:
        """Add one state between command and amplifier."""
        smooth = plan.state("smoothed_force", "N", self.key)
        plan.rates["smoothed_force"] = tau * self.corner_hz * (plan.command - smooth)
        plan.command = smooth


@effect("amplifier", "current does not follow its command at once")
class Amplifier(Effect):
    """Current amplifier of finite bandwidth."""

    bandwidth_hz: float = number(gt=0, le=1e7)  # -3 dB of current over its command

    def build(self, plan: Blueprint) -> None:
        """Give the motor force a state, which `compose` writes."""
        plan.amplifier_rad_s = tau * self.bandwidth_hz


@effect(
    "amplifier_limits",
    "command and active damping share one amplifier: in an impact at full force nothing is left"
    " for the damping",
    "motor force held inside what current and voltage reach",
)
class AmplifierLimits(Effect):
    """Limits of current and voltage on command and active damping together (`model.friction`)."""

    max_current_a: float = number(gt=0, le=1e4)  # of the amplifier, through the winding
    max_voltage_v: float = number(gt=0, le=1e4)  # at its output: the supply minus its own drop
    # in series with the winding: amplifier, cable, contacts and shunt
    series_ohm: float = number(0.0, ge=0, le=1e4)
    inductance_h: float = number(gt=0, le=10)  # of winding and cable

    def build(self, plan: Blueprint) -> None:
        """Set the limits; `compose` applies them where it closes the loop."""
        plan.amplifier_range = AmplifierRange(
            self.max_current_a, self.max_voltage_v, self.series_ohm, self.inductance_h
        )


@effect("damping_dac", "the damping scale factor is a count", "level rounded to a count")
class DampingDac(Effect):
    """The converter of the damping scale factor."""

    quantum_ns_per_m: float = number(gt=0)  # damping of one count

    def build(self, plan: Blueprint) -> None:
        """Set the damping of one count."""
        plan.numbers["active_damping_quantum_ns_per_m"] = self.quantum_ns_per_m


@effect(
    "damping_circuit", "the back-EMF estimate is filtered; its bandwidth sets the damping ceiling"
)
class DampingCircuit(Effect):
    """The analog velocity estimate has a bandwidth."""

    bandwidth_hz: float = number(gt=0, le=1e7)  # -3 dB of the velocity estimate

    def build(self, plan: Blueprint) -> None:
        """Give the estimate a state, which `compose` writes."""
        plan.circuit_rad_s = tau * self.bandwidth_hz


@effect(
    "multiplier",
    "analog multipliers have gain and offset errors: switching damping steps the force",
)
class Multiplier(Effect):
    """Errors of the analog multiplier of velocity and scale factor (the paper's AD534)."""

    gain_error: float = number(0.0, gt=-1, le=10)  # relative: 0.01 is 1 % too much
    scale_offset_ns_per_m: float = number(0.0, ge=-10, le=10)  # added to the commanded level
    velocity_offset_m_per_s: float = number(0.0, ge=-1, le=1)  # added to the velocity estimate
    # one-sided density of the estimate's noise, (m/s)^2/Hz
    noise_psd: float = number(0.0, ge=0, le=1)

    def build(self, plan: Blueprint) -> None:
        """Change the effective damping level and the velocity that it multiplies."""
        plan.level_gain += self.gain_error
        plan.level_offset_ns_per_m += self.scale_offset_ns_per_m
        plan.estimate_offset_m_per_s += self.velocity_offset_m_per_s
        plan.estimate_psd += self.noise_psd


@effect("crowbar", "a shorted winding damps by itself, and gives no torque")
class Crowbar(Effect):
    """The motor shorted: damping K_m^2 / R (Weir 2008, Eq. 3).

    Torque and crowbar exclude each other.
    """

    def build(self, plan: Blueprint) -> None:
        """Disconnect the motor from the command; `compose` writes the damping instead."""
        plan.crowbar = True


class SampleTiming(NamedTuple):
    """How a simulated board realises a delay.

    The OUT of the next tick takes effect (1 - sample_phase + lag_periods) periods after the sample.
    """

    sample_phase: float  # 0..1 of a period: when the board latches a sample after an OUT
    lag_periods: int  # whole periods by which a torque takes effect later


def sample_timing(delay_periods: float) -> SampleTiming:
    """Return the timing of a board whose delay from sample to force is `delay_periods`."""
    whole = floor(delay_periods)
    return SampleTiming(1.0 - (delay_periods - whole), whole)


# --- damping that depends on frequency ------------------------------------------------------------


@effect(
    "shaped_damping",
    "damping that acts only above a corner, below one, or between two, instead of everywhere",
)
class ShapedDamping(Effect):
    """Active damping above `highpass_hz` and below `lowpass_hz`, first order each."""

    highpass_hz: float = number(0.0, ge=0, le=1e6)  # w_l / 2 pi; 0 for none
    lowpass_hz: float = number(0.0, ge=0, le=1e6)  # w_h / 2 pi; 0 for none

    def build(self, plan: Blueprint) -> None:
        """Set the corners; `shaped` writes the filter where `compose` closes the loop."""
        plan.shaping_rad_s = tau * self.highpass_hz, tau * self.lowpass_hz


def shaped(plan: Blueprint, estimate: Form) -> Form:
    """Return the velocity estimate at the input of the multiplier: one state for each corner."""
    above, below = plan.shaping_rad_s
    if above:
        slow = plan.state("slow_estimate", "m/s", ShapedDamping.key)
        plan.rates["slow_estimate"] = above * (estimate - slow)
        estimate = estimate - slow
    if below:
        smooth = plan.state("smooth_estimate", "m/s", ShapedDamping.key)
        plan.rates["smooth_estimate"] = below * (estimate - smooth)
        estimate = smooth
    return estimate


# --- the motor winding ----------------------------------------------------------------------------


def copper_ohm(resistance_ohm: float, reference_c: float, temperature_c: float) -> float:
    """Return the resistance [ohm] of copper at `temperature_c`; `resistance_ohm` at
    `reference_c`.
    """
    return resistance_ohm * (1.0 + COPPER_PER_K * (temperature_c - reference_c))


@effect("motor", "force per ampere and ohms, for currents, losses and the crowbar")
class Motor(Effect):
    """Motor and lever; always built: constants without a state."""

    torque_constant_nm_per_a: float = number(gt=0, le=100)  # K_m
    lever_m: float = number(gt=0, le=10)  # radius that turns torque into endpoint force
    resistance_ohm: float = number(gt=0, le=1e4)  # at reference_c
    # temperature at which the resistance was measured
    reference_c: float = number(20.0, ge=-40, le=150)

    def build(self, plan: Blueprint) -> None:
        """Set the winding at its reference temperature, fully compensated."""
        plan.torque_constant_n_per_a = self.torque_constant_nm_per_a / self.lever_m
        plan.resistance_ohm = self.resistance_ohm
        plan.copper = Copper(
            self.resistance_ohm, self.reference_c, self.resistance_ohm, self.reference_c
        )


@effect(
    "winding",
    "copper's resistance grows 0.393 %/K; what is not compensated scales damping and force by"
    " alpha",
)
class WindingTemperature(Effect):
    """The winding's temperature differs from that of the resistance compensation."""

    temperature_c: float = number(ge=-40, le=250)  # of the copper
    # temperature for which the resistance compensation was set
    compensated_c: float = number(ge=-40, le=250)

    def build(self, plan: Blueprint) -> None:
        """Set the residual resistance. `Motor` precedes it in the order of composition."""
        cold = plan.copper
        compensated_ohm = copper_ohm(cold.resistance_ohm, cold.reference_c, self.compensated_c)
        plan.resistance_ohm = copper_ohm(cold.resistance_ohm, cold.reference_c, self.temperature_c)
        plan.residual_ohm = plan.resistance_ohm - compensated_ohm
        plan.copper = cold._replace(compensated_ohm=compensated_ohm, start_c=self.temperature_c)


@effect(
    "heating",
    "8 N cost some 38 W of copper loss: the winding warms up and the compensation drifts",
    "temperature driven by the square of the current, resistance in the loop",
)
class WindingHeating(Effect):
    """Copper loss heats the winding while it works."""

    thermal_resistance_k_per_w: float = number(ge=0, le=1e4)  # winding to surroundings
    time_constant_s: float = number(gt=0, le=1e5)  # of the winding against its surroundings
    ambient_c: float = number(ge=-40, le=100)  # of the surroundings

    def build(self, plan: Blueprint) -> None:
        """Add a slow state of its own, outside the linear model. `Motor` and `WindingTemperature`
        precede it.
        """
        plan.heating = HeatingParams(
            **plan.copper._asdict(),
            thermal_resistance_k_per_w=self.thermal_resistance_k_per_w,
            time_constant_s=self.time_constant_s,
            ambient_c=self.ambient_c,
        )

    def time_constants_s(self) -> tuple[float, ...]:
        """That of the winding to its surroundings."""
        return (self.time_constant_s,)


@effect("inductance", "an uncancelled part of L di/dt looks like velocity")
class InductanceError(Effect):
    """L di/dt is cancelled incompletely (error_h > 0) or too much (< 0)."""

    error_h: float = number(ge=-1, le=1)  # true minus compensated; > 0: not cancelled completely

    def build(self, plan: Blueprint) -> None:
        """Feed the derivative of the current into the estimate."""
        plan.inductance_error_h = self.error_h


# --- measurement ----------------------------------------------------------------------------------


@effect("encoder", "position comes in counts", "position rounded to a count")
class Encoder(Effect):
    """The encoder that the servo reads."""

    quantum_m: float = number(gt=0)  # travel of one count

    def build(self, plan: Blueprint) -> None:
        """Set the travel of one count."""
        plan.numbers["encoder_quantum_m"] = self.quantum_m


@effect("probe_adc", "torque and velocity of the record come in counts", "record rounded to counts")
class ProbeAdc(Effect):
    """The converters of the probe's record."""

    velocity_quantum_m_per_s: float = number(gt=0)  # velocity of one count
    torque_quantum_n: float = number(gt=0)  # endpoint force of one count

    def build(self, plan: Blueprint) -> None:
        """Set the velocity and the force of one count."""
        plan.numbers["velocity_quantum_m_per_s"] = self.velocity_quantum_m_per_s
        plan.numbers["torque_quantum_n"] = self.torque_quantum_n


@effect(
    "velocity_highpass",
    "an AC-coupled velocity amplifier makes a spring look active at low frequency",
)
class VelocityHighpass(Effect):
    """The velocity amplifier is AC-coupled."""

    corner_hz: float = number(gt=0, le=1e6)  # -3 dB of the AC coupling

    def build(self, plan: Blueprint) -> None:
        """Add one state behind the velocity coil."""
        rate_rad_s = tau * self.corner_hz
        low = plan.state("velocity_baseline", "m/s", self.key)
        plan.rates["velocity_baseline"] = rate_rad_s * (plan.channel - low)
        plan.channel = plan.channel - low
        plan.travel = low / rate_rad_s


@effect(
    "anti_alias",
    "keeps frequencies above 2 kHz out of the record; equal in both channels: no effect on Z",
)
class AntiAlias(Effect):
    """The same second-order Butterworth low-pass before both converters of the record."""

    corner_hz: float = number(gt=0, le=1e6)  # -3 dB, Butterworth of the second order

    def build(self, plan: Blueprint) -> None:
        """Add two states per channel."""
        plan.channel, kept = self._filtered(plan, "recorded_velocity", "m/s", plan.channel)
        plan.travel -= kept
        _, delayed = self._filtered(plan, "recorded_torque", "N", Form.symbol("torque"))
        plan.impulse = -delayed

    def time_constants_s(self) -> tuple[float, ...]:
        """The delay at low frequency."""
        return (2.0 * ZETA / (tau * self.corner_hz),)

    def _filtered(self, plan: Blueprint, name: str, unit: str, signal: Form) -> tuple[Form, Form]:
        """Return the low-passed signal, and the part of its integral that the filter retains."""
        w = tau * self.corner_hz
        low = plan.state(name, unit, self.key)
        slope = plan.state(f"{name}_slope", f"{unit}/s", self.key)
        plan.rates[name] = slope
        plan.rates[f"{name}_slope"] = w * w * (signal - low) - 2.0 * ZETA * w * slope
        return low, (slope + 2.0 * ZETA * w * low) / (w * w)


@effect(
    "sensor_noise",
    "the velocity coil's amplifier is noisy: |Z| is biased, its phase is not",
    "random",
)
class SensorNoise(Effect):
    """White noise of the velocity channel."""

    velocity_m_per_s: float = number(ge=0, le=10)  # rms, added to each 4 kHz value of the record

    def build(self, plan: Blueprint) -> None:
        """Set the rms."""
        plan.velocity_noise_m_per_s = self.velocity_m_per_s


# --- the catalogue --------------------------------------------------------------------------------


# every class of effect above, in the order of its definition, which is the order of composition
KINDS: tuple[type[Effect], ...] = tuple(
    kind
    for kind in list(globals().values())
    if isinstance(kind, type) and issubclass(kind, Effect) and kind is not Effect
)
ALWAYS = (Masses.key, Motor.key)  # always built
BY_KEY = {kind.key: kind for kind in KINDS}


def in_order(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Return `effects` in the order of composition."""
    keys = list(BY_KEY)
    return tuple(sorted(effects, key=lambda effect: keys.index(effect.key)))
