"""Frozen parameters in SI units, and their JSON form.

`settings` validates TOML with pydantic and creates these objects. `servo.json` and `gateway.json`
are their plain JSON form, so that the servo process needs neither TOML nor pydantic. `from_plain`
rebuilds a tree and refuses unknown or missing keys. Parameters of models, of the simulated board
and of the guard's worker are in `model.params`.
"""

import dataclasses
import json
import math
import types
import typing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

from hapticd.core.environment import (
    Constraints,
    Duration,
    Environment,
    NotNegative,
    Positive,
    ServoRateHz,
    TableParams,
    WorkspaceParams,
)
from hapticd.core.errors import ConfigError
from hapticd.core.units import round_half_up

__all__ = [
    "ACTIVE_DAMPING_NS_PER_M",
    "CALIBRATION_DAYS",
    "COMMISSIONING_SHARE",
    "ENERGY_LIMIT_J",
    "LEAST_IDLE_SHARE",
    "LONGEST_LEASE_S",
    "LONGEST_TIMEOUT_MS",
    "MOST_CORRECTION",
    "RAMP_ENERGY_J",
    "RIG_STEPS",
    "SHORTEST_LEASE_S",
    "STRICT_POLICIES",
    "AtEnd",
    "BasisName",
    "DampingMode",
    "DeviceParams",
    "EnvironmentLimits",
    "GatewayParams",
    "GatewaySetup",
    "GuardParams",
    "GuardTable",
    "HomeParams",
    "LeaseParams",
    "Leased",
    "Policy",
    "RealtimeParams",
    "ResistanceParams",
    "RigStep",
    "SafetyParams",
    "ScaleParams",
    "ServoParams",
    "UsbParams",
    "UsbTable",
    "from_plain",
    "read_params",
    "to_plain",
]

T = TypeVar("T")

# words of the guard and of leases in files, messages and commands (docs/guard.md)
Policy = Literal["off", "warn", "clamp", "refuse", "follow"]
BasisName = Literal["theorem", "predicted", "measured"]
DampingMode = Literal["off", "level", "auto"]
Leased = Literal["environment", "active_damping", "perturbation", "measuring"]
AtEnd = Literal["hold", "zero", "disable"]
STRICT_POLICIES = frozenset({"clamp", "refuse", "follow"})  # refuse unknown environments

ENERGY_LIMIT_J = 0.02  # of an 8 g handle at 2.2 m/s; see ADR-0014
RAMP_ENERGY_J = 0.03  # K = 600 N/m applied 10 mm off its centre; see ADR-0013
COMMISSIONING_SHARE = 0.1  # of the device's force, until its signs are verified; see ADR-0029
CALIBRATION_DAYS = 365  # see ADR-0029
SHORTEST_LEASE_S = 0.2  # twenty passes of the gateway
LONGEST_LEASE_S = 60.0
LONGEST_TIMEOUT_MS = 5  # of a transfer; docs/safety.md derives the end of force from it
ACTIVE_DAMPING_NS_PER_M = 1.74  # of `damping on`: Weir, Colgate and Peshkin 2008, section 5


RigStep = Literal[
    "rig encoder",
    "rig motor",
    "rig back-EMF",
    "rig damping",
    "rig probe",
    "rig temperature",
    "rig identify",
]
RIG_STEPS: tuple[str, ...] = get_args(RigStep)
# between a measured scale and the board's nominal one; more means a wrong unit, range or board
MOST_CORRECTION = 1.5
LEAST_IDLE_SHARE = 0.25  # of a period, required idle time of a tick


@dataclass(frozen=True, slots=True)
class ScaleParams:
    """value = sign * (count - offset_count) * per_count, and the source of the numbers."""

    per_count: float
    sign: int = 1
    offset_count: float = 0.0
    half_width_95: float | None = None  # of the 95 % interval of per_count; None: unknown
    measured_on: str = ""  # ISO date
    measured_by: str = ""  # a `MeasuredBy`
    serial: str = ""  # of the measured board; "": that of the device file
    source: str = ""  # description

    @property
    def measured(self) -> bool:
        """Whether a step of `hapticd rig` measured it."""
        return self.measured_by in RIG_STEPS

    def to_value(self, count: float) -> float:
        """Return the SI value of `count`."""
        return self.sign * (count - self.offset_count) * self.per_count

    def to_count(self, value: float, low: int, high: int) -> int:
        """Return the nearest count for a finite SI `value`, clamped to `low`..`high`."""
        return max(
            low, min(high, round_half_up(self.sign * value / self.per_count + self.offset_count))
        )


@dataclass(frozen=True, slots=True)
class HomeParams(TableParams):
    """The search for the origin of position."""

    method: Literal["none", "stop", "index"] = "none"
    required: bool = False
    """Refuse to enable before homing."""
    direction: Literal[-1, 1] = -1
    speed_m_per_s: Annotated[float, Constraints(gt=0, le=1)] = 0.01
    force_n: Positive = 0.5
    position_m: float = 0.0
    """Position of the stop or index."""
    timeout_s: Annotated[float, Constraints(gt=0, le=600)] = 10.0
    tolerance_m: Annotated[float, Constraints(gt=0, le=0.01)] = 50e-6
    """Largest distance between the two finds, and largest yield of a stop under half the push."""
    back_off_m: Annotated[float, Constraints(gt=0, le=0.1)] = 2e-3
    """Distance between the two approaches; at least eight times the tolerance."""
    current_n_per_a: NotNegative = 0.0
    """Endpoint force per ampere of the motor; 0: its current is not checked."""


@dataclass(frozen=True, slots=True)
class ResistanceParams:
    """The compensation of the winding's resistance by the board, and the data of the winding
    (render.winding). The circuit assumes base_ohm + trim.
    """

    trim: ScaleParams  # ohm above base_ohm per count of the DAC
    full_scale_ohm: float  # added by 32767 counts
    base_ohm: float  # compensated at count 0
    winding_ohm: float  # of the winding at reference_c
    reference_c: float
    per_k: float  # relative change of its resistance
    tolerance_ohm: float  # by which the compensation stays below the winding's resistance
    slew_ohm_per_s: float  # of the trim
    force_n_per_a: float  # endpoint force per ampere of the motor
    heat_from: str  # source for the heating of the winding: "current" | "force"
    thermal_resistance_k_per_w: float  # winding to surroundings
    time_constant_s: float  # of the winding against its surroundings
    ambient_low_c: float  # the surroundings are never colder,
    ambient_high_c: float  # and never hotter
    model_error: float  # relative error of thermal resistance and time constant


@dataclass(frozen=True, slots=True)
class EnvironmentLimits:
    """Lowest and highest K [N/m], B [N s/m] and M [kg] that a client may request."""

    lowest: tuple[float, ...]
    highest: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class DeviceParams:
    """A device file: the value of a count on this device, and its limits."""

    name: str
    serial: str
    position: ScaleParams  # m
    force: ScaleParams  # N
    active_damping: ScaleParams  # N s/m of active damping
    probe_torque: ScaleParams  # N at the endpoint
    probe_velocity: ScaleParams  # m/s
    current: ScaleParams  # A
    voltage: ScaleParams  # V
    emf_velocity: ScaleParams  # m/s
    temperature: ScaleParams  # degC
    force_limit_n: float
    active_damping_limit_ns_per_m: float
    probe_limit_n: float
    temperature_limit_c: float
    speed_limit_m_per_s: float  # a higher speed is a sensor fault, not a motion
    home: HomeParams = HomeParams()
    # required capabilities of the board: "probe", "temperature"
    relies_on: tuple[str, ...] = ()
    # corner of a first-order low-pass on the commanded force, if a model has one; 0: none
    force_smoothing_hz: float = 0.0
    overspeed_m_per_s: float | None = None  # a higher speed for some ms is a fault; None: off
    # guaranteed N s/m of the device, from its file; None: unknown, no fault `energy`
    physical_damping_ns_per_m: float | None = None
    energy_limit_j: float = ENERGY_LIMIT_J  # energy given out without cover: fault `energy`
    # largest step of force [N] in one tick by an enable or a change of parameters; infinite: any
    force_step_n: float = math.inf
    # a higher acceleration is accepted only if the next sample continues from it (servo.samples)
    acceleration_limit_m_per_s2: float = math.inf
    # energy that enables and changes of parameters may add within a second (servo.energy)
    ramp_energy_j: float = math.inf
    resistance: ResistanceParams | None = None  # None: the board's compensation stays at count 0
    motor_n_per_a: float = 0.0  # force at the endpoint per ampere, from the device file; 0: unknown
    winding_ohm: float = 0.0  # at `winding_reference_c`, from the device file; 0: unknown
    winding_reference_c: float = 20.0
    motor_lever_m: float = 1.0  # radius that turns torque into force, from [motor]; 1: unknown
    # its signs are not verified: limited force, K, B and M (servo.safety)
    commissioning: bool = False
    signs_firmware: str = ""  # of the board when its signs were verified, like 1.0; "": any
    active_damping_with_force_n: float = (
        0.0  # full scale of force when damping was measured; 0: unknown
    )
    probe_skew_us: float = 0.0  # delay of the probe's velocity relative to its force
    calibration_days: int = CALIBRATION_DAYS  # maximum age of a calibration
    environment_limits: EnvironmentLimits | None = None  # None: those of the mailbox alone

    def temperature_counts(self, low: int, high: int) -> tuple[int, int]:
        """Return the lowest and highest count, inside `low`..`high`, of an allowed temperature.
        With sign -1 the count falls as the winding gets hot.
        """
        limit = self.temperature.to_count(self.temperature_limit_c, low, high)
        return (low, limit) if self.temperature.sign > 0 else (limit, high)


@dataclass(frozen=True, slots=True)
class SafetyParams(TableParams):
    """Times and levels of the safety table."""

    force_limit_n: Positive | None = None
    """Tighter than the device's own limit; default: the device's limit."""
    enable_ramp_s: Duration = 0.5
    stop_ramp_s: Annotated[float, Constraints(ge=0, le=1)] = 0.02
    active_damping_hold_s: Duration = 2.0
    active_damping_release_s: Duration = 0.5
    safe_active_damping_ns_per_m: NotNegative = 0.0
    """Active damping held after a stop or fault."""
    active_damping_slew_ns_per_m_s: Annotated[float, Constraints(gt=0, le=1e6)] = 20.0
    gateway_timeout_s: Annotated[float, Constraints(ge=0.2, le=60)] = 1.0
    on_gateway_loss: Literal["fault", "hold"] = "fault"
    lost_slots_limit: Annotated[int, Constraints(ge=1, le=10_000)] = 10
    """Ticks that may be missed within one second on hardware."""
    missing_frames_limit: Annotated[int, Constraints(ge=1, le=100)] = 8
    # periods for which the board may withhold torque while enabled
    no_authority_limit: Annotated[int, Constraints(ge=1, le=100)] = 8
    glitches_limit: Annotated[int, Constraints(ge=0, le=1000)] = 2
    """Bad encoder samples that may occur within one second."""
    default_ramp_s: Duration = 0.05
    """Ramp of a `set` without one."""
    # a trial at the edge of stability switches it off
    limit_cycle_faults: bool = True
    """Faults force_at_limit and energy."""
    energy_controller: bool = False
    """Before the fault `energy`, raise the active damping, then reduce K, B, M and walls."""
    proxy_speed_m_per_s: Positive = 1.0
    """Fastest motion of a proxy."""
    proxy_timeout_s: Annotated[float, Constraints(ge=0.002, le=1)] = 0.1
    """A proxy without a new position for this time stays where it is."""
    proxy_energy_j: NotNegative = 0.1
    """Energy that a law may put into the spring beyond what it took from it."""
    proxy_power_w: NotNegative = 0.02
    """Rate at which used energy of a law is granted again."""
    proxy_stored_j: NotNegative = 1.0
    """Energy taken from the spring that a law may return later, at most."""


@dataclass(frozen=True, slots=True)
class RealtimeParams(TableParams):
    """Resources that the servo process requests from the operating system."""

    rate_hz: ServoRateHz = 1000.0
    mode: Literal["strict", "best_effort", "off"] = "best_effort"
    """strict: refuse to start without the rights; best_effort: use the granted ones, and report."""
    priority: Annotated[int, Constraints(ge=1, le=99)] = 79
    core: Annotated[int, Constraints(ge=0)] | None = None
    """Default: the last core that this process may use."""
    spin_us: Annotated[float, Constraints(ge=0, le=10_000)] = 100.0
    """Busy waiting before each deadline."""
    lock_memory: bool = True
    grace_s: Duration = 1.0
    """Overruns in this time after the start are counted separately."""


@dataclass(frozen=True, slots=True)
class UsbTable(TableParams):
    """USB identity and transfers of the board; its serial number is in the device file."""

    vendor_id: Annotated[int, Constraints(ge=0, le=0xFFFF)] = 0x1209
    product_id: Annotated[int, Constraints(ge=0, le=0xFFFF)] = 0x0001
    # the schema contains the limit; `settings.load` refuses with its reason
    timeout_ms: Annotated[int, Constraints(ge=1)] = field(
        default=1, metadata={"json_schema_extra": {"maximum": LONGEST_TIMEOUT_MS}}
    )
    """Time-out of one transfer. A silent board may delay the end of force by one time-out."""
    in_flight: bool = False
    """Transfers continue while the servo computes, so the force acts earlier."""


@dataclass(frozen=True, slots=True)
class UsbParams(UsbTable):
    """USB identity of the board: serial None matches any."""

    serial: str | None = None


@dataclass(frozen=True, slots=True)
class ServoParams:
    """Everything the servo process needs (servo.json)."""

    instance: str
    simulated: bool
    environment: Environment
    device: DeviceParams
    safety: SafetyParams
    realtime: RealtimeParams
    usb: UsbParams
    active_damping_ns_per_m: float = ACTIVE_DAMPING_NS_PER_M
    config_hash: str = ""
    device_file: str = ""  # source of `device`; "": none
    device_file_sha256: str = ""  # of its bytes then

    def __post_init__(self) -> None:
        if self.safety.force_limit_n is None:
            safety = replace(self.safety, force_limit_n=self.device.force_limit_n)
            object.__setattr__(self, "safety", safety)  # as a frozen dataclass requires

    @property
    def force_limit_n(self) -> float:
        """The largest commanded force [N], by configuration and device. It is a tenth of the
        device's until its signs are verified.
        """
        share = COMMISSIONING_SHARE if self.device.commissioning else 1.0
        device_n = share * self.device.force_limit_n
        asked_n = self.safety.force_limit_n
        return device_n if asked_n is None else min(asked_n, device_n)

    @property
    def soft_ends(self) -> WorkspaceParams:
        """The soft ends of the workspace. They have no springs until the signs of the device are
        verified, because their side is unknown.
        """
        ends = self.environment.workspace
        return replace(ends, stiffness_n_per_m=0.0) if self.device.commissioning else ends


@dataclass(frozen=True, slots=True)
class GatewayParams(TableParams):
    """The address of telemetry. Commands use a socket in the runtime folder."""

    telemetry_port: Annotated[int, Constraints(ge=0, le=65_535)] = 9872  # PlotJuggler's default
    """0, or a port in use: any free one."""
    batch: Annotated[int, Constraints(ge=1, le=1000)] = 20
    """Ticks in one `servo` message."""
    tcp_host: Annotated[str, Constraints(min_length=1)] = "127.0.0.1"
    allow_insecure: bool = False
    """Offer telemetry beyond this machine without keys."""
    curve_keys: str | None = None
    """Folder with the server's key and those of allowed clients."""
    flight_s: Annotated[float, Constraints(gt=0, le=600)] = 60.0
    """Time covered by the flight recorder, at every tick."""


@dataclass(frozen=True, slots=True)
class GuardTable(TableParams):
    """The treatment of environments that are not known to be passive."""

    policy: Policy | None = None
    """Default: `refuse` on hardware whose device file has a [model], otherwise `warn`."""
    basis: BasisName = "theorem"
    """theorem: for any input and hand; predicted: with friction, at the amplitude of a trial;
    measured: within the limits in the file `measured`.
    """
    measured: str | None = None
    """A .zwidth file of this device; a relative path starts at the folder of this file."""
    margin_ns_per_m: Annotated[float, Constraints(ge=0, le=100)] = 0.0
    """Margin required of an allowed environment."""


@dataclass(frozen=True, slots=True)
class GuardParams(GuardTable):
    """The guard's table with this device's values in place of omitted ones; "" means no file."""

    policy: Policy = "warn"
    measured: str = ""


@dataclass(frozen=True, slots=True)
class LeaseParams(TableParams):
    """The defaults of a client's lease."""

    ttl_s: Annotated[float, Constraints(ge=SHORTEST_LEASE_S, le=LONGEST_LEASE_S)] = 5.0
    """A lease ends when its holder has sent no request for this time."""
    at_end: AtEnd = "zero"
    """Action when the holder dies or falls silent. zero: K, B and M, if they were leased, ramp to
    0; disable: force off; hold: all stays. Active damping stays in any case.
    """


@dataclass(frozen=True, slots=True)
class GatewaySetup:
    """gateway.json: the gateway's own parameters, and the servo's for limits and scales."""

    servo: ServoParams
    gateway: GatewayParams = GatewayParams()
    guard: GuardParams = GuardParams()
    lease: LeaseParams = LeaseParams()


def to_plain(value: Any) -> Any:
    """Return a dataclass tree as dicts and lists for json."""
    return dataclasses.asdict(value)


def from_plain(kind: type[T], plain: Any, where: str = "") -> T:
    """Return dicts and lists as a dataclass tree of type `kind`. ConfigError with the path of a
    wrong key.
    """
    known = {item.name: item for item in dataclasses.fields(kind)}  # type: ignore[arg-type]
    if not isinstance(plain, dict):
        raise ConfigError(f"{where or kind.__name__}: expected a table, got {type(plain).__name__}")
    unknown = sorted(set(plain) - set(known))
    if unknown:
        raise ConfigError(
            f"{where or kind.__name__}: unknown key {unknown[0]!r}; written by another version?"
            " resolve again"
        )
    hints = typing.get_type_hints(kind)
    try:
        return kind(
            **{key: _value(hints[key], item, f"{where}.{key}") for key, item in plain.items()}
        )
    except TypeError as error:
        raise ConfigError(
            f"{where or kind.__name__}: {error}; written by another version? resolve again"
        ) from error


def read_params(kind: type[T], path: Path) -> T:
    """Return the parameters of `kind` in the JSON file `path`. ConfigError with the file."""
    try:
        return from_plain(kind, json.loads(path.read_text()), str(path))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: {error}; make it with `hapticd config resolve`") from error


def _value(hint: Any, plain: Any, where: str) -> Any:
    one_of = typing.get_origin(hint) in (types.UnionType, typing.Union)
    for kind in typing.get_args(hint) if one_of else (hint,):
        origin = typing.get_origin(kind)
        if dataclasses.is_dataclass(kind) and isinstance(plain, dict):
            return from_plain(kind, plain, where)  # type: ignore[arg-type]
        if origin is tuple and isinstance(plain, list | tuple):
            return tuple(_value(typing.get_args(kind)[0], item, where) for item in plain)
        if kind is float and isinstance(plain, int) and not isinstance(plain, bool):
            return float(plain)
        fits = plain in typing.get_args(kind) if origin is Literal else isinstance(plain, kind)
        if fits and plain == plain:  # NaN passes every limit
            return plain
    raise ConfigError(f"{where}: expected {hint}, got {plain!r}; resolve the configuration again")
