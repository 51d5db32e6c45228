"""What effects write into while a model is composed: states and their rates, bodies and the forces on them, signals.

    command -> smoothing -> (+) -> amplifier -> motor force -> rotor -- coupling -- slider -> encoder
                             ^                                   |
                             '-- multiplier <- estimate <--------'-> probe: torque in, velocity channel out

Effects are applied in the order of the catalogue, each finding the signals as the ones before it left them. `drive`
(electrical) then closes the loop of the damping circuit. Standard library alone; `compose` turns the result into arrays.
"""

from dataclasses import dataclass, field

from hapticd.plant.forms import Form
from hapticd.plant.parts import Note, State


@dataclass
class Body:
    """A moving mass: `force` collects what acts on it, Coulomb friction apart."""

    name: str
    position: Form
    velocity: Form
    mass_kg: float
    force: Form = field(default_factory=Form)
    coulomb_n: float = 0.0


@dataclass
class Blueprint:
    """A model that is being composed."""

    states: list[State] = field(default_factory=list)
    rates: dict[str, Form] = field(default_factory=dict)
    inputs: list[str] = field(default_factory=list)
    bodies: dict[str, Body] = field(default_factory=dict)
    slider_kg: float = 0.0  # of the rotor's mass, until a coupling takes it off
    notes: list[Note] = field(default_factory=list)

    command: Form = field(default_factory=Form)  # virtual force on its way to the amplifier, N
    travel: Form = field(default_factory=Form)  # integral of the recorded velocity, m
    channel: Form = field(default_factory=Form)  # the recorded velocity, m/s
    impulse: Form | None = None  # what filters delay of the recorded torque, N s
    motor: Form = field(default_factory=Form)  # motor force at the endpoint, N
    estimate: Form = field(default_factory=Form)  # back-EMF velocity estimate, m/s

    delay_periods: float = 0.0
    amplifier_rad_s: float | None = None
    circuit_rad_s: float | None = None
    shaping_rad_s: tuple[float, float] = (0.0, 0.0)  # corners of high-pass and low-pass of the damping, 0 for none
    level_gain: float = 1.0
    level_offset_ns_per_m: float = 0.0
    estimate_offset_m_per_s: float = 0.0
    estimate_psd: float = 0.0
    torque_constant_n_per_a: float = 1.0
    resistance_ohm: float = 0.0
    residual_ohm: float = 0.0
    inductance_error_h: float = 0.0
    crowbar: bool = False
    probe_mass_kg: float = 0.0
    viscous_ns_per_m: float = 0.0
    numbers: dict[str, float] = field(default_factory=dict)  # quanta and limits, by their names in Model
    ends_m: tuple[float, float] | None = None
    rotor_forces: list[tuple[str, tuple[float, ...]]] = field(default_factory=list)  # law, its numbers
    velocity_noise_m_per_s: float = 0.0
    heating: tuple[float, float, float] | None = None  # K/W, s, ambient degC
    winding: tuple[float, float, float, float] = (
        0.0,
        20.0,
        0.0,
        20.0,
    )  # ohm at reference, reference degC, compensated ohm, start degC

    @property
    def rotor(self) -> Body:
        """Where motor and probe act."""
        return self.bodies["rotor"]

    @property
    def endpoint(self) -> Body:
        """Where hand and load act and the encoder sits: the slider, or the rotor of a rigid device."""
        return self.bodies.get("slider", self.rotor)

    def state(self, name: str, unit: str, effect: str, rate: Form | None = None) -> Form:
        """Add a state; its rate may be given later in `rates`."""
        self.states.append(State(name, unit, effect))
        if rate is not None:
            self.rates[name] = rate
        return Form.symbol(name)

    def input(self, name: str) -> Form:
        """Add an input."""
        self.inputs.append(name)
        return Form.symbol(name)

    def rotor_force(self, law: str, *numbers: float) -> None:
        """Add a force on the rotor that is not linear: `law` is its name in both backends, SI units."""
        if not self.rotor_forces:
            self.rotor.force += self.input("rotor_force")
        self.rotor_forces.append((law, numbers))

    def body(self, name: str, mass_kg: float, effect: str) -> Body:
        """Add a body with its position and velocity, both free."""
        position = self.state(f"{name}_position", "m", effect)
        velocity = self.state(f"{name}_velocity", "m/s", effect)
        self.rates[f"{name}_position"] = velocity
        self.bodies[name] = Body(name, position, velocity, mass_kg)
        return self.bodies[name]
