"""What effects write into while a model is composed: linear forms, states and their rates, bodies.

    command -> smoothing -> (+) -> amplifier -> motor force -> rotor - coupling - slider -> encoder
                             ^                                   |
                             '-- multiplier <- estimate <--------'-> probe: torque in, velocity out

Effects are applied in the order of the catalogue (`effects.KINDS`), each finding the signals as the
ones before it left them. `compose` then closes the loop of the damping circuit and turns the result
into arrays.

A form is a sum over states and inputs, each with a coefficient that may depend on the commanded
damping level b and on the residual winding resistance r, each at most to the first power:
c = c1 + cb b + cr r + cbr b r. So the composed A and B are affine in b and in r, which is what
`Model` promises. A product that would leave this set is refused: it means that two effects close an
algebraic loop that needs a lag (an amplifier or a circuit with a bandwidth) to be solved.

Standard library alone: reading a settings file must not load numpy.

What would break it: two effects that write the same rate (the later one would win in silence), or a
body whose name a state of another effect already has.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

Coefficient = tuple[float, float, float, float]  # of 1, b, r, b r

ONE: Coefficient = (1.0, 0.0, 0.0, 0.0)
ZERO: Coefficient = (0.0, 0.0, 0.0, 0.0)


class Form:
    """Immutable sum of coefficient x symbol; symbols are names of states and inputs."""

    __slots__ = ("terms",)

    def __init__(self, terms: Mapping[str, Coefficient] | None = None) -> None:
        self.terms: Mapping[str, Coefficient] = terms or {}

    @classmethod
    def symbol(cls, name: str) -> "Form":
        """The state or input `name` itself."""
        return cls({name: ONE})

    def __add__(self, other: "Form") -> "Form":
        total = dict(self.terms)
        for name, (one, b, r, br) in other.terms.items():
            mine = total.get(name, ZERO)
            total[name] = (mine[0] + one, mine[1] + b, mine[2] + r, mine[3] + br)
        return Form(total)

    def __mul__(self, factor: float) -> "Form":
        return Form({name: (factor * c[0], factor * c[1], factor * c[2], factor * c[3]) for name, c in self.terms.items()})

    __rmul__ = __mul__

    def __neg__(self) -> "Form":
        return -1.0 * self

    def __sub__(self, other: "Form") -> "Form":
        return self + -other

    def __truediv__(self, divisor: float) -> "Form":
        return (1.0 / divisor) * self

    def times_level(self) -> "Form":
        """Multiplied by the damping level. ValueError if it depends on the level already."""
        if any(c[1] or c[3] for c in self.terms.values()):
            raise ValueError("a form of the second degree in the damping level")
        return Form({name: (0.0, c[0], 0.0, c[2]) for name, c in self.terms.items()})

    def times_residual(self) -> "Form":
        """Multiplied by the residual resistance. ValueError if it depends on it already."""
        if any(c[2] or c[3] for c in self.terms.values()):
            raise ValueError("a form of the second degree in the residual resistance")
        return Form({name: (0.0, 0.0, c[0], c[1]) for name, c in self.terms.items()})


@dataclass(frozen=True, slots=True)
class StateVariable:
    """One state variable: name, unit, and the effect that brought it."""

    name: str
    unit: str
    effect: str


@dataclass(frozen=True, slots=True)
class InputColumns:
    """Columns of B and D. `width` is their number, contacts included."""

    command: int
    torque: int
    width: int
    estimate: int | None = None
    rotor_force: int | None = None


@dataclass(frozen=True, slots=True)
class Note:
    """One effect in words: why it is there, what it adds, its time constants [s], parameters with unit and source tag."""

    effect: str
    why: str
    states: tuple[str, ...] = ()
    nonlinearity: str = ""
    time_constants_s: tuple[float, ...] = ()
    parameters: tuple[tuple[str, float, str, str], ...] = ()  # name, value, unit, paper | inferred | calibrated


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

    states: list[StateVariable] = field(default_factory=list)
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
        self.states.append(StateVariable(name, unit, effect))
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
