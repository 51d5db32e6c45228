"""The words of a composed model: states, inputs, and notes on its effects. Standard library alone."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class State:
    """One state variable: name, unit, and the effect that brought it."""

    name: str
    unit: str
    effect: str


@dataclass(frozen=True, slots=True)
class Inputs:
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
