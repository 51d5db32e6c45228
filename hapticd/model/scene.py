"""A scene: a device, what it renders, what moves it, and which of its effects exist.

Plain values in SI units.

A scene file (config/scenes/NAME.toml) is read by `hapticd.settings.scene`, which builds these;
`compose` turns the device and the names in `effects` into a `Model`. An effect that is not named is
not built: no state, no instruction, no time.
"""

from dataclasses import dataclass, field

from hapticd.core.environment import Environment
from hapticd.model.effects import Effect

__all__ = ["DampingStep", "Excitation", "Scene"]


@dataclass(frozen=True, slots=True)
class Excitation:
    """What the probe does, as endpoint force.

    none        nothing
    noise       Gaussian, of one-sided density `psd_n2_per_hz` up to `band_hz`; held for 250 us
    multisine   every harmonic of 1 / `period_s` up to `band_hz`, random phases, rms `force_n`
    push        constant `force_n` from `start_s` on
    """

    kind: str = "none"  # none | noise | multisine | push
    psd_n2_per_hz: float = 2.5e-5  # noise: one-sided density; 2.5e-5 to 1.7 kHz is 0.21 N rms
    band_hz: float = 1700.0  # noise: flat up to here; multisine: highest harmonic
    force_n: float = 0.0  # multisine: rms; push: its level
    start_s: float = 0.0  # push: when it begins
    period_s: float = 1.0  # multisine
    seed: int = 1  # of noise and of the multisine's phases


@dataclass(frozen=True, slots=True)
class DampingStep:
    """From `at_s` on the servo asks for this active damping."""

    at_s: float  # since the start of the scene
    level_ns_per_m: float  # active damping


@dataclass(frozen=True, slots=True)
class Scene:
    """What is simulated."""

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
