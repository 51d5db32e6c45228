"""What a composed model consists of, as data: states, modes, nonlinearities, and why each effect is there."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import inf, tau

from hapticd.plant.model import Model
from hapticd.plant.parts import Note, State
from hapticd.plant.stability import Stability, modes, stability

NEARLY_ZERO_PER_S = 1e-9


@dataclass(frozen=True, slots=True)
class Mode:
    """An eigenvalue of the open device, a conjugate pair told once. A real one has frequency 0 and damping ratio 1 (-1: grows)."""

    time_constant_s: float  # of its envelope; infinite if it neither decays nor grows
    frequency_hz: float
    damping_ratio: float


@dataclass(frozen=True, slots=True)
class AtLevel:
    """The open device at one damping level: whether it is stable, alpha at DC, and its modes from slow to fast."""

    damping_ns_per_m: float
    stability: Stability
    alpha: float
    modes: tuple[Mode, ...]


@dataclass(frozen=True, slots=True)
class Explanation:
    """Of a model: its states, what is not linear, its effects in words, and its behaviour at some damping levels."""

    states: tuple[State, ...]
    nonlinearities: tuple[tuple[str, str], ...]  # effect, what it does
    notes: tuple[Note, ...]
    levels: tuple[AtLevel, ...]
    delay_s: float
    fastest_s: float  # shortest time constant of all


def explain(model: Model, levels_ns_per_m: Iterable[float] = (0.0,)) -> Explanation:
    """`model` in data, with its modes at these damping levels."""
    found = tuple(at_level(model, level) for level in levels_ns_per_m)
    return Explanation(
        states=model.states,
        nonlinearities=tuple((note.effect, note.nonlinearity) for note in model.notes if note.nonlinearity),
        notes=model.notes,
        levels=found,
        delay_s=model.delay_periods / model.rate_hz,
        fastest_s=min(
            (1.0 / abs(value) for value in modes(model, max(level.damping_ns_per_m for level in found)) if value), default=inf
        ),
    )


def at_level(model: Model, damping_ns_per_m: float) -> AtLevel:
    """Stability and modes of the open device at that damping level."""
    verdict = stability(model, damping_ns_per_m)
    upper = [complex(value) for value in modes(model, damping_ns_per_m) if value.imag >= 0.0]
    slow_first = sorted(upper, key=abs)
    return AtLevel(damping_ns_per_m, verdict, 1.0 / (1.0 + verdict.loop_gain), tuple(_mode(value) for value in slow_first))


def _mode(value: complex) -> Mode:
    size = abs(value)
    decay = -value.real
    time_constant_s = 1.0 / decay if abs(decay) > NEARLY_ZERO_PER_S else inf
    return Mode(time_constant_s, abs(value.imag) / tau, decay / size if size > NEARLY_ZERO_PER_S else 0.0)
