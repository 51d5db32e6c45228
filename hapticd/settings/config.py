"""hapticd.toml: settings that apply to any device.

Tables that the processes read unchanged are in `core.params`, with their defaults and limits. The
tables here are translated. `load` checks the limits of a device.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, create_model

from hapticd.core.constraints import Constraints, Positive, TableParams
from hapticd.core.environment import (
    FIELDS,
    STRENGTHS,
    Environment,
    FilterParams,
    WallParams,
    WorkspaceParams,
)
from hapticd.core.params import (
    BoardTraits,
    GatewayParams,
    GuardTable,
    LeaseParams,
    RealtimeParams,
    SafetyParams,
    ServoParams,
    UsbTable,
)
from hapticd.settings.tables import TomlTable

__all__ = ["Config"]

_environment = Environment()
_wall = WallParams()
_ends = WorkspaceParams()
_active_damping_ns_per_m: Any = ServoParams.__dataclass_fields__["active_damping_ns_per_m"].default

Capability = Literal["probe", "temperature", "sample_phase", "resistance", "event"]
SERIAL_NUMBER: dict[str, Any] = {"min_length": 1, "max_length": 16, "pattern": r"^[!-~]+$"}


_RANGES: dict[str, Any] = {one.path: {"ge": one.low, "le": one.high} for one in FIELDS}
# numbers of the environment itself; the active damping has its own table
RENDERED = tuple(one.path for one in STRENGTHS if "." not in one.path)
FrequencyHz = Annotated[float, Field(**_RANGES["velocity_filter.frequency_hz"])]
DampingRatio = Annotated[float, Field(**_RANGES["velocity_filter.damping_ratio"])]


class Filter(TomlTable):
    frequency_hz: FrequencyHz
    """Corner of the second-order low-pass; at most 0.45 of the servo rate."""
    damping_ratio: DampingRatio = FilterParams(1.0).damping_ratio
    """0.7071 is Butterworth."""
    mapping: Literal["prewarped", "bilinear", "matched"] = "prewarped"
    """Discretisation of the filter."""


def _filter(default: FilterParams) -> Filter:
    return Filter(frequency_hz=default.frequency_hz, damping_ratio=default.damping_ratio)


class WallTable(TomlTable):
    stiffness_n_per_m: float = Field(_wall.stiffness_n_per_m, **_RANGES["wall.stiffness_n_per_m"])
    virtual_damping_ns_per_m: float = Field(
        _wall.virtual_damping_ns_per_m, **_RANGES["wall.virtual_damping_ns_per_m"]
    )
    position_m: float = Field(_wall.position_m, **_RANGES["wall.position_m"])
    side: Literal[-1, 0, 1] = 0
    """+1: solid beyond the position, -1: solid before it, 0: no wall."""


class Workspace(TomlTable):
    stiffness_n_per_m: float = Field(_ends.stiffness_n_per_m, ge=0, le=1e5)
    """Springs at both ends of the device's travel; 0: none."""
    margin_m: float = Field(0.0, ge=0, le=10)
    """Distance from each end of travel at which they begin."""


if TYPE_CHECKING:  # a generated model cannot be a base class for a type checker
    Rendered = TomlTable
else:
    Rendered = create_model(
        "Rendered",
        __base__=TomlTable,
        **{
            path: (float, Field(getattr(_environment, path), **limits))
            for path, limits in _RANGES.items()
            if path in RENDERED
        },
    )


class EnvironmentTable(Rendered):
    """The environment rendered at start; `hapticd set` changes it live."""

    velocity_filter: Filter = _filter(_environment.velocity_filter)
    acceleration_filter: Filter = _filter(_environment.acceleration_filter)
    wall: WallTable = WallTable()
    workspace: Workspace = Workspace()


@dataclass(frozen=True, slots=True)
class SimulatedBoard(TableParams):
    """Differences of the simulated board from its device file.

    Its hello reports them and it behaves accordingly; omitted fields follow the device file.
    """

    serial: Annotated[str, Constraints(**SERIAL_NUMBER)] | None = None
    """Only in the hello: it is still found by the device file's serial number."""
    lacks: Annotated[tuple[Capability, ...], Constraints(strict=False)] = ()
    """Capabilities that the board lacks."""
    position_m_per_count: Positive | None = None
    force_full_scale_n: Positive | None = None
    damping_full_scale_ns_per_m: Positive | None = None
    probe_torque_full_scale_n: Positive | None = None
    probe_velocity_full_scale_m_per_s: Positive | None = None
    current_full_scale_a: Positive | None = None
    voltage_full_scale_v: Positive | None = None
    force_limit_n: Positive | None = None
    """The board clamps the torque to this limit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulation(BoardTraits):
    """The simulated board's firmware; ignored with a real one."""

    sample_phase: Annotated[float, Constraints(ge=0, lt=1)] | None = None
    """Time at which the encoder is latched, in periods after the board received a command.

    Default: from the device's delay."""
    effects: Annotated[tuple[str, ...], Constraints(strict=False)] | None = None
    """Effects of the device to build. Default: those of its file."""
    board: SimulatedBoard = SimulatedBoard()


class Config(TomlTable):
    """hapticd.toml"""

    device: str = Field("simulated", min_length=1)
    """Name of a device file (devices/NAME.toml next to this file, or a shipped one), or a path."""
    active_damping_ns_per_m: float = Field(_active_damping_ns_per_m, ge=0)
    """Active damping of `hapticd damping on`."""
    environment: EnvironmentTable = EnvironmentTable()
    safety: SafetyParams = SafetyParams()
    realtime: RealtimeParams = RealtimeParams()
    usb: UsbTable = UsbTable()
    gateway: GatewayParams = GatewayParams()
    guard: GuardTable = GuardTable()
    lease: LeaseParams = LeaseParams()
    simulation: Simulation = Simulation()
