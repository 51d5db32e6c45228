"""What lies between the force command and the motor force: transport, converter, smoothing, amplifier, damping circuit.

Each effect here leaves its number in the blueprint; `drive` writes the equations of the loop that they make together.
"""

from dataclasses import dataclass
from math import floor, tau
from typing import ClassVar

from hapticd.plant.blueprint import Blueprint
from hapticd.plant.effects import Effect, number


@dataclass(frozen=True, slots=True, kw_only=True)
class Delay(Effect):
    """From the encoder sample to the force that it leads to, in servo periods; may be fractional and more than 1."""

    key: ClassVar[str] = "delay"
    why: ClassVar[str] = "computing and transport take time"
    periods: float = number(ge=0, le=10)

    def build(self, plan: Blueprint) -> None:
        """Shift the command."""
        plan.delay_periods = self.periods


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceDac(Effect):
    """The torque command is a count."""

    key: ClassVar[str] = "force_dac"
    why: ClassVar[str] = "the torque command is a count"
    nonlinearity: ClassVar[str] = "force rounded to a count"
    quantum_n: float = number(gt=0)

    def build(self, plan: Blueprint) -> None:
        """Remember its step."""
        plan.numbers["force_quantum_n"] = self.quantum_n


@dataclass(frozen=True, slots=True, kw_only=True)
class Saturation(Effect):
    """The force command is limited."""

    key: ClassVar[str] = "saturation"
    why: ClassVar[str] = "motor and amplifier give so much and no more; bounds what is unstable"
    nonlinearity: ClassVar[str] = "force held inside its limit"
    limit_n: float = number(gt=0)

    def build(self, plan: Blueprint) -> None:
        """Remember the limit."""
        plan.numbers["force_limit_n"] = self.limit_n


@dataclass(frozen=True, slots=True, kw_only=True)
class Smoothing(Effect):
    """First-order low-pass on the virtual-force command alone, not on the damping."""

    key: ClassVar[str] = "smoothing"
    why: ClassVar[str] = "reconstruction filter behind the torque DAC: lag of the virtual force at low frequency"
    corner_hz: float = number(gt=0, le=1e6)

    def build(self, plan: Blueprint) -> None:
        """One state between command and amplifier."""
        smooth = plan.state("smoothed_force", "N", self.key)
        plan.rates["smoothed_force"] = tau * self.corner_hz * (plan.command - smooth)
        plan.command = smooth

    def time_constants_s(self) -> tuple[float, ...]:
        """Its lag."""
        return (1.0 / (tau * self.corner_hz),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Amplifier(Effect):
    """Current amplifier of finite bandwidth."""

    key: ClassVar[str] = "amplifier"
    why: ClassVar[str] = "current does not follow its command at once"
    bandwidth_hz: float = number(gt=0, le=1e7)

    def build(self, plan: Blueprint) -> None:
        """Gives the motor force a state."""
        plan.amplifier_rad_s = tau * self.bandwidth_hz

    def time_constants_s(self) -> tuple[float, ...]:
        """Its lag."""
        return (1.0 / (tau * self.bandwidth_hz),)


@dataclass(frozen=True, slots=True, kw_only=True)
class DampingDac(Effect):
    """The damping scale factor is a count."""

    key: ClassVar[str] = "damping_dac"
    why: ClassVar[str] = "the damping scale factor is a count"
    nonlinearity: ClassVar[str] = "level rounded to a count"
    quantum_ns_per_m: float = number(gt=0)

    def build(self, plan: Blueprint) -> None:
        """Remember its step."""
        plan.numbers["damping_quantum_ns_per_m"] = self.quantum_ns_per_m


@dataclass(frozen=True, slots=True, kw_only=True)
class DampingCircuit(Effect):
    """The analog velocity estimate has a bandwidth."""

    key: ClassVar[str] = "damping_circuit"
    why: ClassVar[str] = "the back-EMF estimate is filtered; its bandwidth sets the damping ceiling"
    bandwidth_hz: float = number(gt=0, le=1e7)

    def build(self, plan: Blueprint) -> None:
        """Gives the estimate a state."""
        plan.circuit_rad_s = tau * self.bandwidth_hz

    def time_constants_s(self) -> tuple[float, ...]:
        """Its lag."""
        return (1.0 / (tau * self.bandwidth_hz),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Multiplier(Effect):
    """Analog multiplier of velocity and scale factor (the paper's AD534): gain and offset errors, noise."""

    key: ClassVar[str] = "multiplier"
    why: ClassVar[str] = "analog multipliers have gain and offset errors: switching damping steps the force"
    gain_error: float = number(0.0, gt=-1, le=10)
    scale_offset_ns_per_m: float = number(0.0, ge=-10, le=10)
    velocity_offset_m_per_s: float = number(0.0, ge=-1, le=1)
    noise_psd: float = number(0.0, ge=0, le=1)

    def build(self, plan: Blueprint) -> None:
        """Change the level that arrives and what it is multiplied with."""
        plan.level_gain += self.gain_error
        plan.level_offset_ns_per_m += self.scale_offset_ns_per_m
        plan.estimate_offset_m_per_s += self.velocity_offset_m_per_s
        plan.estimate_psd += self.noise_psd


@dataclass(frozen=True, slots=True, kw_only=True)
class Crowbar(Effect):
    """The motor shorted: damping K_m^2 / R (Weir 2008, Eq. 3). Torque and crowbar exclude each other."""

    key: ClassVar[str] = "crowbar"
    why: ClassVar[str] = "a shorted winding damps by itself, and gives no torque"

    def build(self, plan: Blueprint) -> None:
        """Nothing of the command arrives."""
        plan.crowbar = True


def sample_timing(delay_periods: float) -> tuple[float, int]:
    """(sample_phase, lag_periods): when a board latches after an OUT, and how much later a torque takes effect.

    The OUT of the next tick then acts (1 - sample_phase + lag_periods) periods after the sample, which is `delay_periods`.
    """
    whole = floor(delay_periods)
    return 1.0 - (delay_periods - whole), whole
