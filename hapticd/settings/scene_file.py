"""scenes/NAME.toml: a device, what it renders, what moves it, and which of its effects exist."""

from typing import Any, Literal

from pydantic import Field

from hapticd.params import RealtimeParams
from hapticd.plant.scene import Excitation
from hapticd.settings.models import Environment
from hapticd.settings.quantities import Table

_excitation = Excitation()


class DampingStepTable(Table):
    """Electrical damping that the servo asks for from `at_s` on."""

    at_s: float = Field(0.0, ge=0)
    level_ns_per_m: float = Field(ge=0)


class ExcitationTable(Table):
    """What the probe does, as endpoint force."""

    kind: Literal["none", "noise", "multisine", "push"] = "none"
    psd_n2_per_hz: float = Field(_excitation.psd_n2_per_hz, ge=0)
    """One-sided density of the noise."""
    band_hz: float = Field(_excitation.band_hz, gt=0, le=2000)
    """Upper edge of noise and multisine."""
    force_n: float = Field(_excitation.force_n, ge=-100, le=100)
    """Of a push; rms of a multisine."""
    start_s: float = Field(_excitation.start_s, ge=0)
    period_s: float = Field(_excitation.period_s, gt=0)
    seed: int = Field(_excitation.seed, ge=0)


class Start(Table):
    """The endpoint at time 0."""

    position_m: float = 0.0
    velocity_m_per_s: float = 0.0


class SceneFile(Table):
    """A scene file."""

    title: str = Field(min_length=1)
    device: str = Field(min_length=1)
    """Name of a simulated device (devices/NAME.toml), or a path to one."""
    effects: tuple[str, ...] = Field(strict=False)
    """Effects of the device that are built; nothing else is."""
    seconds: float = Field(10.0, gt=0, le=1e6)
    rate_hz: float = Field(RealtimeParams().rate_hz, ge=50, le=20_000)
    allow_unstable: bool = False
    """Simulate a device whose damping circuit oscillates by itself."""
    environment: Environment = Environment()
    damping: tuple[DampingStepTable, ...] = Field((), strict=False)
    excitation: ExcitationTable = ExcitationTable()
    start: Start = Start()
    model: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """What is different about the device: tables of its [model], changed number by number."""
