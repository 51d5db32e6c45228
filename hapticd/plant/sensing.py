"""What is seen of the motion: the servo's encoder, and the probe's 4 kHz record of torque and velocity.

A record holds means over its 250 us, so that the sum of torque x velocity x 250 us is the exact work. The mean of a
filtered channel needs no extra state: a first-order high-pass y = v - h, h' = w (v - h) has the integral h / w, and a
second-order low-pass y'' + 2 zeta w y' + w^2 y = w^2 u has the integral of u minus (y' + 2 zeta w y) / w^2. These integrals are
`travel` (of velocity) and `impulse` (what the filter keeps back of the torque).
"""

from dataclasses import dataclass
from math import sqrt, tau
from typing import ClassVar

from hapticd.plant.blueprint import Blueprint
from hapticd.plant.effects import Effect, number
from hapticd.plant.forms import Form

ZETA = sqrt(0.5)  # Butterworth


@dataclass(frozen=True, slots=True, kw_only=True)
class Encoder(Effect):
    """The servo sees counts."""

    key: ClassVar[str] = "encoder"
    why: ClassVar[str] = "position comes in counts"
    nonlinearity: ClassVar[str] = "position rounded to a count"
    quantum_m: float = number(gt=0)

    def build(self, plan: Blueprint) -> None:
        """Remember its step."""
        plan.numbers["encoder_quantum_m"] = self.quantum_m


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbeAdc(Effect):
    """The record holds counts."""

    key: ClassVar[str] = "probe_adc"
    why: ClassVar[str] = "torque and velocity of the record come in counts"
    nonlinearity: ClassVar[str] = "record rounded to counts"
    velocity_quantum_m_per_s: float = number(gt=0)
    torque_quantum_n: float = number(gt=0)

    def build(self, plan: Blueprint) -> None:
        """Remember both steps."""
        plan.numbers["velocity_quantum_m_per_s"] = self.velocity_quantum_m_per_s
        plan.numbers["torque_quantum_n"] = self.torque_quantum_n


@dataclass(frozen=True, slots=True, kw_only=True)
class VelocityHighpass(Effect):
    """The velocity amplifier is AC-coupled."""

    key: ClassVar[str] = "velocity_highpass"
    why: ClassVar[str] = "an AC-coupled velocity amplifier makes a spring look active at low frequency"
    corner_hz: float = number(gt=0, le=1e6)

    def build(self, plan: Blueprint) -> None:
        """One state behind the velocity coil."""
        rate_rad_s, low = tau * self.corner_hz, plan.state("velocity_baseline", "m/s", self.key)
        plan.rates["velocity_baseline"] = rate_rad_s * (plan.channel - low)
        plan.channel, plan.travel = plan.channel - low, low / rate_rad_s

    def time_constants_s(self) -> tuple[float, ...]:
        """Of the coupling capacitor."""
        return (1.0 / (tau * self.corner_hz),)


@dataclass(frozen=True, slots=True, kw_only=True)
class AntiAlias(Effect):
    """The same second-order Butterworth low-pass before both converters of the record."""

    key: ClassVar[str] = "anti_alias"
    why: ClassVar[str] = "keeps what lies above 2 kHz out of the record; equal in both channels, so the ratio stays"
    corner_hz: float = number(gt=0, le=1e6)

    def build(self, plan: Blueprint) -> None:
        """Two states per channel."""
        plan.channel, kept = self._filtered(plan, "recorded_velocity", "m/s", plan.channel)
        plan.travel -= kept
        _, delayed = self._filtered(plan, "recorded_torque", "N", Form.symbol("torque"))
        plan.impulse = -delayed

    def time_constants_s(self) -> tuple[float, ...]:
        """Its delay at low frequency."""
        return (2.0 * ZETA / (tau * self.corner_hz),)

    def _filtered(self, plan: Blueprint, name: str, unit: str, signal: Form) -> tuple[Form, Form]:
        """The low-passed signal, and how much of its integral the filter keeps back."""
        w = tau * self.corner_hz
        low, slope = plan.state(name, unit, self.key), plan.state(f"{name}_slope", f"{unit}/s", self.key)
        plan.rates[name] = slope
        plan.rates[f"{name}_slope"] = w * w * (signal - low) - 2.0 * ZETA * w * slope
        return low, (slope + 2.0 * ZETA * w * low) / (w * w)


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorNoise(Effect):
    """White noise of the velocity channel."""

    key: ClassVar[str] = "sensor_noise"
    why: ClassVar[str] = "the velocity coil's amplifier is noisy: |Z| is biased, its phase is not"
    nonlinearity: ClassVar[str] = "random"
    velocity_m_per_s: float = number(ge=0, le=10)

    def build(self, plan: Blueprint) -> None:
        """Remember its rms."""
        plan.velocity_noise_m_per_s = self.velocity_m_per_s
