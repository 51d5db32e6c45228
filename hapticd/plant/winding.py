"""The motor winding: what a newton costs in amperes and watts, and how heat spoils the resistance compensation.

    R(T) = R_0 (1 + 0.00393 (T - T_0))          copper (the paper prints "percent"; 0.393 %/K is meant)
    T'   = (R(T) (F / K)^2 R_th - (T - T_ambient)) / tau
    dR   = R(T) - R_compensated                 the residual that `electrical` feeds back

The paper's Eq. 3 gives the crowbar damping K_m^2 / R = 1.7e-4 Nms/rad. It prints 3.7e-5 Ns/m for it at the endpoint, which
would need a lever of 2.14 m; with the lever of some 10 mm that fits the device it is 1.70 Ns/m. R and K_m themselves are
not printed: R is assumed and K_m follows.
"""

from dataclasses import dataclass
from math import sqrt
from typing import ClassVar

from hapticd.plant.blueprint import Blueprint
from hapticd.plant.effects import Effect, number
from hapticd.units import COPPER_PER_K


def copper_ohm(resistance_ohm: float, reference_c: float, temperature_c: float) -> float:
    """Resistance at `temperature_c` of a copper winding that has `resistance_ohm` at `reference_c`."""
    return resistance_ohm * (1.0 + COPPER_PER_K * (temperature_c - reference_c))


def crowbar_nms_per_rad(torque_constant_nm_per_a: float, resistance_ohm: float) -> float:
    """Damping of a shorted motor (Weir 2008, Eq. 3)."""
    return torque_constant_nm_per_a**2 / resistance_ohm


def lever_of_crowbar_m(crowbar_nms: float, crowbar_ns: float) -> float:
    """The lever radius that would make both of the paper's crowbar figures true."""
    return sqrt(crowbar_nms / crowbar_ns)


@dataclass(frozen=True, slots=True, kw_only=True)
class Motor(Effect):
    """Motor and lever; always built: constants without a state."""

    key: ClassVar[str] = "motor"
    why: ClassVar[str] = "force per ampere and ohms, for currents, losses and the crowbar"
    torque_constant_nm_per_a: float = number(gt=0, le=100)
    lever_m: float = number(gt=0, le=10)
    resistance_ohm: float = number(gt=0, le=1e4)  # at reference_c
    reference_c: float = number(20.0, ge=-40, le=150)

    def build(self, plan: Blueprint) -> None:
        """The winding at its reference temperature, fully compensated."""
        plan.torque_constant_n_per_a = self.torque_constant_nm_per_a / self.lever_m
        plan.resistance_ohm = self.resistance_ohm
        plan.winding = (self.resistance_ohm, self.reference_c, self.resistance_ohm, self.reference_c)


@dataclass(frozen=True, slots=True, kw_only=True)
class WindingTemperature(Effect):
    """The winding is not as warm as the resistance compensation believes."""

    key: ClassVar[str] = "winding"
    why: ClassVar[str] = "copper's resistance grows 0.393 %/K; what is not compensated scales damping and force by alpha"
    temperature_c: float = number(ge=-40, le=250)
    compensated_c: float = number(ge=-40, le=250)

    def build(self, plan: Blueprint) -> None:
        """A residual resistance; needs a `Motor` before."""
        cold_ohm, reference_c, _, _ = plan.winding
        compensated_ohm = copper_ohm(cold_ohm, reference_c, self.compensated_c)
        plan.resistance_ohm = copper_ohm(cold_ohm, reference_c, self.temperature_c)
        plan.residual_ohm = plan.resistance_ohm - compensated_ohm
        plan.winding = (cold_ohm, reference_c, compensated_ohm, self.temperature_c)


@dataclass(frozen=True, slots=True, kw_only=True)
class Heating(Effect):
    """Copper loss heats the winding while it works."""

    key: ClassVar[str] = "heating"
    why: ClassVar[str] = "8 N cost some 38 W of copper loss: the winding warms up and the compensation drifts"
    nonlinearity: ClassVar[str] = "temperature driven by the square of the current, resistance in the loop"
    thermal_resistance_k_per_w: float = number(ge=0, le=1e4)
    time_constant_s: float = number(gt=0, le=1e5)
    ambient_c: float = number(ge=-40, le=100)

    def build(self, plan: Blueprint) -> None:
        """A slow state of its own, outside the linear model."""
        plan.heating = (self.thermal_resistance_k_per_w, self.time_constant_s, self.ambient_c)

    def time_constants_s(self) -> tuple[float, ...]:
        """Of the winding against its surroundings."""
        return (self.time_constant_s,)


@dataclass(frozen=True, slots=True, kw_only=True)
class InductanceError(Effect):
    """L di/dt is not cancelled completely (error_h > 0) or too much (< 0)."""

    key: ClassVar[str] = "inductance"
    why: ClassVar[str] = "what is left of L di/dt looks like velocity"
    error_h: float = number(ge=-1, le=1)

    def build(self, plan: Blueprint) -> None:
        """Feed the derivative of the current to the estimate."""
        plan.inductance_error_h = self.error_h
