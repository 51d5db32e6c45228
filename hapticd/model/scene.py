"""A scene: a device, its rendered environment, its excitation, and the list of its effects. Plain
values in SI units.

A scene file (config/scenes/NAME.toml) is read by `hapticd.settings.scene`, which builds these;
`compose` turns the device and the names in `effects` into a `Model`. An effect that is not listed
is not built and costs no state and no time. Some effects follow from the scales of a device file:
its converters, its limits, and a device that is one rigid mass.
"""

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

from hapticd.core.environment import (
    Constraints,
    Environment,
    NotNegative,
    Positive,
    TableParams,
    WallParams,
)
from hapticd.core.params import DeviceParams, ScaleParams
from hapticd.model.effects import (
    ALWAYS,
    DampingDac,
    Delay,
    Effect,
    Encoder,
    ForceDac,
    Masses,
    Motor,
    ProbeAdc,
    SampleTiming,
    Saturation,
    Smoothing,
    Viscous,
    WorkspaceEnds,
    sample_timing,
)

__all__ = [
    "DampingStep",
    "Excitation",
    "Scene",
    "converter_effects",
    "rigid_body",
    "smoothing_hz",
    "timing_of",
]


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

    @property
    def level_ns_per_m(self) -> float:
        """The highest active damping."""
        return max(step.level_ns_per_m for step in self.active_damping)

    @property
    def free_of_walls(self) -> Environment:
        """The environment without its wall, which has no impedance of its own."""
        return replace(self.environment, wall=WallParams())

    @property
    def noise(self) -> Excitation:
        """The scene's own noise, or the paper's if the scene has none."""
        own = self.excitation
        return own if own.kind == "noise" else Excitation("noise", seed=own.seed)

    @property
    def removable(self) -> tuple[str, ...]:
        """The keys of the effects that can be left out."""
        return tuple(effect.key for effect in self.effects if effect.key not in ALWAYS)

    @property
    def is_linear(self) -> bool:
        """Whether the scene is linear, so that its impedance is known exactly."""
        return (
            not any(effect.nonlinearity for effect in self.effects)
            and self.environment.wall.side == 0
        )

    def without(self, *keys: str) -> "Scene":
        """Return the scene without these effects."""
        return replace(self, effects=tuple(one for one in self.effects if one.key not in keys))


# --- effects by the numbers of a device file ------------------------------------------------------
DEFAULT_PHASE = 0.875  # of a period, as in BoardParams: force acts T / 8 after the sample


def converter_effects(scales: DeviceParams) -> dict[str, Effect]:
    """Return quantisation and limits by the scales of a device, by key.

    The source of a scale becomes the note.
    """
    return {
        "encoder": Encoder(
            quantum_m=scales.position.per_count,
            source=_tag(scales.position),
            note=scales.position.source,
        ),
        "force_dac": ForceDac(quantum_n=scales.force.per_count, note="16 bits"),
        "saturation": Saturation(
            limit_n=scales.force_limit_n, source=_tag(scales.force), note=scales.force.source
        ),
        "damping_dac": DampingDac(
            quantum_ns_per_m=scales.active_damping.per_count, note=scales.active_damping.source
        ),
        "probe_adc": ProbeAdc(
            velocity_quantum_m_per_s=scales.probe_velocity.per_count,
            torque_quantum_n=scales.probe_torque.per_count,
            note=scales.probe_velocity.source,
        ),
    }


def _tag(scale: ScaleParams) -> str:
    """Return the tag of an effect with the numbers of a scale."""
    if scale.measured:
        return "calibrated"
    return "paper" if scale.measured_by == "paper" else "inferred"


def rigid_body(
    scales: DeviceParams,
    mass_kg: float,
    viscous_ns_per_m: float,
    lower_stop_m: float,
    upper_stop_m: float,
    torque_constant_n_per_a: float,
    winding_ohm: float,
) -> tuple[Effect, ...]:
    """Return the effects of a device that is one rigid mass, latched at the default phase."""
    return (
        Masses(rotor_kg=mass_kg),
        Motor(
            torque_constant_nm_per_a=torque_constant_n_per_a,
            lever_m=1.0,
            resistance_ohm=winding_ohm,
        ),
        Viscous(rotor_ns_per_m=viscous_ns_per_m),
        WorkspaceEnds(lower_m=lower_stop_m, upper_m=upper_stop_m),
        Delay(periods=1.0 - DEFAULT_PHASE),
        *converter_effects(scales).values(),
    )


def timing_of(effects: tuple[Effect, ...]) -> SampleTiming:
    """Return the timing of a board with the device's transport delay, or the default
    without one.
    """
    delay = next((effect.periods for effect in effects if isinstance(effect, Delay)), 0.0)
    return sample_timing(delay) if delay else SampleTiming(DEFAULT_PHASE, 0)


def smoothing_hz(effects: tuple[Effect, ...]) -> float:
    """Return the corner [Hz] of the low-pass on the commanded force; 0 without one."""
    return next((one.corner_hz for one in effects if isinstance(one, Smoothing)), 0.0)
