"""What moves: one mass or two, what resists, and what is attached at either end.

    m_r v_r' = -k (x_r - x_s) - b (v_r - v_s) - b_r v_r + F_motor + F_probe + F_cogging - Coulomb
    m_s v_s' =  k (x_r - x_s) + b (v_r - v_s) - b_s v_s + F_load + F_hand              - Coulomb

Everything is reflected to the endpoint (N, m, kg, Ns/m). The encoder sits on the slider, motor, probe and velocity coil on
the rotor: not colocated (Weir 2008, section 2.1). Without `coupling` the two are one mass, and all of it acts on that.
"""

from dataclasses import dataclass
from typing import ClassVar

from hapticd.plant.blueprint import Blueprint
from hapticd.plant.effects import Effect, number


@dataclass(frozen=True, slots=True, kw_only=True)
class Masses(Effect):
    """The masses themselves; always built."""

    key: ClassVar[str] = "masses"
    why: ClassVar[str] = "what is moved"
    rotor_kg: float = number(gt=0, le=100)
    slider_kg: float = number(0.0, ge=0, le=100)

    def build(self, plan: Blueprint) -> None:
        """One rigid body; `Coupling` splits it."""
        rotor = plan.body("rotor", self.rotor_kg + self.slider_kg, self.key)
        plan.slider_kg = self.slider_kg
        plan.travel, plan.channel = rotor.position, rotor.velocity


@dataclass(frozen=True, slots=True, kw_only=True)
class Probe(Effect):
    """The Z-width probe on the rotor: its inertia. Its torque input and velocity output exist on every device."""

    key: ClassVar[str] = "probe"
    why: ClassVar[str] = "the probe moves with the rotor while it measures"
    mass_kg: float = number(ge=0, le=100)

    def build(self, plan: Blueprint) -> None:
        """Heavier rotor."""
        plan.rotor.mass_kg += self.mass_kg
        plan.probe_mass_kg = self.mass_kg


@dataclass(frozen=True, slots=True, kw_only=True)
class Coupling(Effect):
    """A flexible transmission between rotor and slider."""

    key: ClassVar[str] = "coupling"
    why: ClassVar[str] = "the encoder is not on the motor: a mode above 300 Hz between the two"
    stiffness_n_per_m: float = number(gt=0, le=1e9)
    damping_ns_per_m: float = number(ge=0, le=1e5)

    def build(self, plan: Blueprint) -> None:
        """Take the slider off the rotor and hold it by a spring and a damper."""
        rotor = plan.rotor
        rotor.mass_kg -= plan.slider_kg
        slider = plan.body("slider", plan.slider_kg, self.key)
        stretch, rate = rotor.position - slider.position, rotor.velocity - slider.velocity
        held = self.stiffness_n_per_m * stretch + self.damping_ns_per_m * rate
        rotor.force -= held
        slider.force += held


@dataclass(frozen=True, slots=True, kw_only=True)
class Viscous(Effect):
    """Friction proportional to velocity, at either body."""

    key: ClassVar[str] = "viscous"
    why: ClassVar[str] = "physical damping: the budget that sampling and delay spend"
    rotor_ns_per_m: float = number(ge=0, le=1e5)
    slider_ns_per_m: float = number(0.0, ge=0, le=1e5)

    def build(self, plan: Blueprint) -> None:
        """-b v on each body."""
        for body, level in ((plan.rotor, self.rotor_ns_per_m), (plan.endpoint, self.slider_ns_per_m)):
            body.force -= level * body.velocity
            plan.viscous_ns_per_m += level


@dataclass(frozen=True, slots=True, kw_only=True)
class Load(Effect):
    """Mass, spring and damper against ground, fixed to the endpoint."""

    key: ClassVar[str] = "load"
    why: ClassVar[str] = "something is mounted at the endpoint"
    mass_kg: float = number(0.0, ge=0, le=100)
    damping_ns_per_m: float = number(0.0, ge=0, le=1e5)
    stiffness_n_per_m: float = number(0.0, ge=0, le=1e8)

    def build(self, plan: Blueprint) -> None:
        """Act on the endpoint."""
        end = plan.endpoint
        end.mass_kg += self.mass_kg
        end.force -= self.damping_ns_per_m * end.velocity + self.stiffness_n_per_m * end.position


@dataclass(frozen=True, slots=True, kw_only=True)
class Hand(Effect):
    """A passive human: finger mass held by the arm's spring and damper, touching through the finger pad's.

    All parameters are 0 or more, therefore passive (Colgate and Schenkel 1997 need no more of a human).
    """

    key: ClassVar[str] = "hand"
    why: ClassVar[str] = "somebody holds the endpoint"
    mass_kg: float = number(gt=0, le=100)
    damping_ns_per_m: float = number(ge=0, le=1e5)
    stiffness_n_per_m: float = number(ge=0, le=1e8)
    grip_stiffness_n_per_m: float = number(ge=0, le=1e8)
    grip_damping_ns_per_m: float = number(ge=0, le=1e5)

    def build(self, plan: Blueprint) -> None:
        """A body of its own at the endpoint."""
        end, hand = plan.endpoint, plan.body("hand", self.mass_kg, self.key)
        grip = self.grip_stiffness_n_per_m * (end.position - hand.position)
        grip += self.grip_damping_ns_per_m * (end.velocity - hand.velocity)
        end.force -= grip
        hand.force += grip - self.damping_ns_per_m * hand.velocity - self.stiffness_n_per_m * hand.position


@dataclass(frozen=True, slots=True, kw_only=True)
class MagnetCogging(Effect):
    """Torque of the magnets on the iron, periodic in rotor position."""

    key: ClassVar[str] = "cogging"
    why: ClassVar[str] = "iron in the stator pulls the magnets to preferred positions"
    nonlinearity: ClassVar[str] = "force periodic in position"
    amplitude_n: float = number(ge=0, le=100)
    pitch_m: float = number(gt=0, le=1)
    phase_rad: float = number(0.0, ge=-7, le=7)

    def build(self, plan: Blueprint) -> None:
        """A force input that the simulation feeds."""
        plan.rotor_force("sine", self.amplitude_n, self.pitch_m, self.phase_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkspaceEnds(Effect):
    """Inelastic mechanical ends at the endpoint."""

    key: ClassVar[str] = "ends"
    why: ClassVar[str] = "travel ends somewhere"
    nonlinearity: ClassVar[str] = "position held inside the travel"
    lower_m: float = number(ge=-10, le=10)
    upper_m: float = number(ge=-10, le=10)

    def build(self, plan: Blueprint) -> None:
        """Remember them."""
        plan.ends_m = (self.lower_m, self.upper_m)
