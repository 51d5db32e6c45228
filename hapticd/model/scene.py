"""A scene: a device, its rendered environment, its excitation, and the list of its effects. Plain
values in SI units.

A scene file (config/scenes/NAME.toml) is read by `hapticd.settings.scene`, which builds these;
`compose` turns the device and the names in `effects` into a `Model`. An effect that is not listed
is not built and costs no state and no time.
"""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from hapticd.core.environment import Constraints, Environment, NotNegative, Positive, TableParams
from hapticd.model.effects import Effect

__all__ = ["DampingStep", "Excitation", "Scene"]


@dataclass(frozen=True, slots=True)
class Excitation(TableParams):
    """The perturbation of the probe, as endpoint force."""

    kind: Literal["none", "noise", "multisine", "push"] = "none"
    """noise: Gaussian, a new value every 250 us; multisine: all harmonics of 1 / `period_s`, random
    phases; push: a constant force.
    """
    psd_n2_per_hz: NotNegative = 2.5e-5  # up to 1.7 kHz it is 0.21 N rms
    """One-sided density of the noise."""
    band_hz: Annotated[float, Constraints(gt=0, le=2000)] = 1700.0
    """Upper edge of noise and multisine."""
    force_n: Annotated[float, Constraints(ge=-100, le=100)] = 0.0
    """Force of a push; rms of a multisine."""
    start_s: NotNegative = 0.0
    """Start of a push."""
    period_s: Positive = 1.0
    """Period of a multisine."""
    seed: Annotated[int, Constraints(ge=0)] = 1
    """Seed of noise and of a multisine's phases."""


@dataclass(frozen=True, slots=True)
class DampingStep:
    """A change of the requested active damping at `at_s`."""

    at_s: float  # since the start of the scene
    level_ns_per_m: float  # active damping


@dataclass(frozen=True, slots=True)
class Scene:
    """The content of a simulation."""

    name: str
    title: str
    device: str  # name of the device file
    effects: tuple[Effect, ...]  # in the order of composition
    # K, B, M and walls that the servo renders
    environment: Environment = field(default_factory=Environment)
    active_damping: tuple[DampingStep, ...] = (
        DampingStep(0.0, 0.0),
    )  # sorted by time, the first at 0 s
    excitation: Excitation = field(default_factory=Excitation)
    seconds: float = 10.0  # length of the simulation
    rate_hz: float = 1000.0  # of the servo
    start_position_m: float = 0.0  # of the endpoint
    start_velocity_m_per_s: float = 0.0  # of the endpoint
    allow_unstable: bool = False  # simulate a device whose damping circuit oscillates
