"""The target of effects during composition: linear forms, states and their rates, bodies.

    command -> smoothing -> (+) -> amplifier -> motor force -> rotor - coupling - slider -> encoder
                             ^                                   |
                             '-- multiplier <- estimate <--------'-> probe: torque in, velocity out

Effects are applied in the order of the catalogue (`effects.KINDS`). Each takes the signals as the
previous ones left them. `compose` then closes the loop of the damping circuit and turns the result
into arrays.

A form is a sum over states and inputs. Each coefficient may depend on the commanded damping level b
and on the residual winding resistance r, each at most to the first power: c = c1 + cb b + cr r +
cbr b r. The composed A and B are therefore affine in b and in r, as `Model` requires. A product
outside this set is refused: two effects then close an algebraic loop, which needs a lag (an
amplifier or a circuit with a bandwidth).

The module needs only the standard library, because reading a settings file must not load numpy.

Two effects must not write the same rate (the later one would silently win). A body must not have
the name of a state of another effect.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from hapticd.model.params import HeatingParams

__all__ = ["StateVariable"]


class Coefficient(NamedTuple):
    """c = one + level b + residual r + both b r: b damping level, r residual resistance."""

    one: float  # in the unit of the form over that of the symbol, as all four
    level: float  # per Ns/m
    residual: float  # per ohm
    both: float  # per Ns/m and ohm


ONE = Coefficient(1.0, 0.0, 0.0, 0.0)
ZERO = Coefficient(0.0, 0.0, 0.0, 0.0)


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
        for name, more in other.terms.items():
            mine = total.get(name, ZERO)
            total[name] = Coefficient(*(x + y for x, y in zip(mine, more, strict=True)))
        return Form(total)

    def __mul__(self, factor: float) -> "Form":
        return Form({name: Coefficient(*(factor * x for x in c)) for name, c in self.terms.items()})

    __rmul__ = __mul__

    def __neg__(self) -> "Form":
        return -1.0 * self

    def __sub__(self, other: "Form") -> "Form":
        return self + -other

    def __truediv__(self, divisor: float) -> "Form":
        return (1.0 / divisor) * self

    def times_level(self) -> "Form":
        """Multiply by the damping level. ValueError if the form already depends on the level."""
        if any(c.level or c.both for c in self.terms.values()):
            raise ValueError("a form of the second degree in the damping level")
        return Form(
            {name: Coefficient(0.0, c.one, 0.0, c.residual) for name, c in self.terms.items()}
        )

    def times_residual(self) -> "Form":
        """Multiply by the residual resistance. ValueError if the form already depends on it."""
        if any(c.residual or c.both for c in self.terms.values()):
            raise ValueError("a form of the second degree in the residual resistance")
        return Form({name: Coefficient(0.0, 0.0, c.one, c.level) for name, c in self.terms.items()})


@dataclass(frozen=True, slots=True)
class StateVariable:
    """One state variable of a model."""

    name: str  # a position ends in _position, in m; a velocity in _velocity, in m/s
    unit: str
    effect: str  # key of the effect that added it


@dataclass(frozen=True, slots=True)
class InputColumns:
    """Columns of B and D; None for an absent input."""

    command: int  # virtual force, N
    torque: int  # perturbation of the probe, as endpoint force, N
    width: int  # number of columns, those of the contacts included
    estimate: int | None = None  # error of the velocity estimate, m/s
    rotor_force: int | None = None  # nonlinear force on the rotor, N
    amplifier: int | None = None  # change of motor force rate by amplifier limits, N/s


class Parameter(NamedTuple):
    """One number of an effect."""

    name: str
    value: float  # in `unit`
    unit: str
    source: str  # paper | inferred | calibrated


@dataclass(frozen=True, slots=True)
class Note:
    """Description of one effect."""

    effect: str  # its key
    why: str
    states: tuple[str, ...] = ()  # names of the states that it added
    nonlinearity: str = ""  # empty for a linear effect
    time_constants_s: tuple[float, ...] = ()  # its own
    parameters: tuple[Parameter, ...] = ()


class Copper(NamedTuple):
    """The motor winding at the start."""

    resistance_ohm: float  # at reference_c
    reference_c: float
    compensated_ohm: float  # assumed by the damping circuit
    start_c: float


class AmplifierRange(NamedTuple):
    """The limits of the amplifier, and the circuit that it drives."""

    current_a: float  # largest
    voltage_v: float  # largest, at its output
    series_ohm: float  # in series with the winding
    inductance_h: float  # of that circuit


NO_MOTOR = Copper(0.0, 20.0, 0.0, 20.0)


@dataclass
class Body:
    """A moving mass."""

    name: str
    position: Form  # m
    velocity: Form  # m/s
    mass_kg: float
    force: Form = field(default_factory=Form)  # all forces but Coulomb friction, N
    coulomb_n: float = 0.0  # level of its Coulomb friction


@dataclass
class Blueprint:
    """A model during composition. Forces and masses are those at the endpoint."""

    states: list[StateVariable] = field(default_factory=list)
    rates: dict[str, Form] = field(default_factory=dict)  # time derivative of each state, by name
    inputs: list[str] = field(default_factory=list)
    bodies: dict[str, Body] = field(default_factory=dict)
    slider_kg: float = 0.0  # part of the rotor's mass, until a coupling separates it
    notes: list[Note] = field(default_factory=list)

    command: Form = field(default_factory=Form)  # virtual force before the amplifier, N
    travel: Form = field(default_factory=Form)  # integral of the recorded velocity, m
    channel: Form = field(default_factory=Form)  # the recorded velocity, m/s
    impulse: Form | None = None  # delay of the recorded torque by filters, N s
    motor: Form = field(default_factory=Form)  # motor force, N
    estimate: Form = field(default_factory=Form)  # back-EMF velocity estimate, m/s

    delay_periods: float = 0.0  # of the servo, from encoder sample to force
    amplifier_rad_s: float | None = None  # None for an amplifier without lag
    amplifier_range: AmplifierRange | None = None  # None for one without limits
    circuit_rad_s: float | None = None  # bandwidth of the velocity estimate; None for no lag
    # corners of high-pass and low-pass in the active damping; 0 for none
    shaping_rad_s: tuple[float, float] = (0.0, 0.0)
    level_gain: float = 1.0  # of the multiplier, on the commanded damping level
    level_offset_ns_per_m: float = 0.0  # added to the level behind that gain
    estimate_offset_m_per_s: float = 0.0  # added to the velocity estimate
    estimate_psd: float = 0.0  # one-sided density of the estimate's noise, (m/s)^2/Hz
    torque_constant_n_per_a: float = 1.0  # K_m / lever radius
    resistance_ohm: float = 0.0  # of the winding as it is at the start
    residual_ohm: float = 0.0  # true minus compensated
    inductance_error_h: float = 0.0  # true minus compensated
    crowbar: bool = False  # the motor is shorted
    probe_mass_kg: float = 0.0  # part of the rotor's mass
    viscous_ns_per_m: float = 0.0  # all viscous friction, at both bodies
    # quanta and limits, by their names in `Model`
    numbers: dict[str, float] = field(default_factory=dict)
    ends_m: tuple[float, float] | None = None  # lower and upper end of travel
    # law and its numbers, SI units
    rotor_forces: list[tuple[str, tuple[float, ...]]] = field(default_factory=list)
    velocity_noise_m_per_s: float = 0.0  # rms, added to each 4 kHz value of the record
    heating: HeatingParams | None = None  # None: the winding keeps its temperature
    copper: Copper = NO_MOTOR

    @property
    def rotor(self) -> Body:
        """The body on which motor and probe act."""
        return self.bodies["rotor"]

    @property
    def endpoint(self) -> Body:
        """The body of hand, load and encoder: the slider, or the rotor of a rigid device."""
        return self.bodies.get("slider", self.rotor)

    def state(self, name: str, unit: str, effect: str) -> Form:
        """Add a state, whose rate must be set in `rates`."""
        self.states.append(StateVariable(name, unit, effect))
        return Form.symbol(name)

    def input(self, name: str) -> Form:
        """Add an input."""
        self.inputs.append(name)
        return Form.symbol(name)

    def rotor_force(self, law: str, *numbers: float) -> None:
        """Add a nonlinear force on the rotor.

        `law` is its name in both backends; `numbers` are its parameters in SI units.
        """
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
