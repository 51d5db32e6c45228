"""A scene: a device, what it renders, what moves it, and which of its effects exist. Plain values in SI units.

A scene file (config/scenes/NAME.toml) is read by `hapticd.settings.scene`, which builds these; `compose` turns the device
and the names in `effects` into a `Model`. An effect that is not named is not built: no state, no instruction, no time.
"""

from dataclasses import dataclass, field

from hapticd.params import EnvironmentParams
from hapticd.plant.effects import Effect


@dataclass(frozen=True, slots=True)
class Excitation:
    """What the probe does, as endpoint force.

    kind: "none" | "noise" (Gaussian, one-sided density `psd_n2_per_hz` flat to `band_hz`, a value held for 250 us) |
    "multisine" (random phases, one period of `period_s`, rms `force_n`, up to `band_hz`) | "push" (constant `force_n`
    from `start_s` on).
    """

    kind: str = "none"
    psd_n2_per_hz: float = 2.5e-5
    band_hz: float = 1700.0
    force_n: float = 0.0
    start_s: float = 0.0
    period_s: float = 1.0
    seed: int = 1


@dataclass(frozen=True, slots=True)
class DampingStep:
    """From `at_s` on the servo asks for this electrical damping."""

    at_s: float
    level_ns_per_m: float


@dataclass(frozen=True, slots=True)
class Scene:
    """What is simulated. `effects` are in the order of composition; `damping` is sorted by time and starts at 0 s."""

    name: str
    title: str
    device: str
    effects: tuple[Effect, ...]
    environment: EnvironmentParams = field(default_factory=EnvironmentParams)
    damping: tuple[DampingStep, ...] = (DampingStep(0.0, 0.0),)
    excitation: Excitation = field(default_factory=Excitation)
    seconds: float = 10.0
    rate_hz: float = 1000.0
    start_position_m: float = 0.0
    start_velocity_m_per_s: float = 0.0
    allow_unstable: bool = False  # simulate a device whose damping circuit oscillates
