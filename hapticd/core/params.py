"""Frozen parameters in SI units, and their JSON form.

`settings` validates TOML with pydantic and creates these objects. `servo.json` and `board.json` are
their plain JSON form, so that the servo process needs neither TOML nor pydantic. `from_plain`
rebuilds a tree and refuses unknown or missing keys.
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
    Microseconds,
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
    "BoardParams",
    "BoardTraits",
    "BusParams",
    "Contact",
    "DampingMode",
    "DeviceParams",
    "DriveLimits",
    "Ends",
    "EnvironmentLimits",
    "GatewayParams",
    "GatewaySetup",
    "GuardParams",
    "GuardSetup",
    "GuardTable",
    "HandParams",
    "HeatingParams",
    "HomeParams",
    "InjectionParams",
    "LeaseParams",
    "Leased",
    "MeasuredLevel",
    "MeasuredParams",
    "ModelParams",
    "Noise",
    "OutputParams",
    "PlantParams",
    "Policy",
    "RealtimeParams",
    "ResistanceParams",
    "RigStep",
    "RotorForce",
    "SafetyParams",
    "ScaleParams",
    "ServoParams",
    "TouchParams",
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
LAST_TICK = 10**12  # of an injection: 30 years at 1 kHz
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
class InjectionParams(TableParams):
    """One seeded fault of the simulated board."""

    kind: Annotated[str, Constraints(min_length=1)]
    tick: Annotated[int, Constraints(ge=-1, le=LAST_TICK)] = -1
    """Tick of the fault; -1: by probability."""
    probability: Annotated[float, Constraints(ge=0, le=1)] = 0.0
    count: Annotated[int, Constraints(ge=1, le=LAST_TICK)] = 1
    value: Annotated[float, Constraints(ge=-1e9, le=1e9)] = 0.0


@dataclass(frozen=True, slots=True)
class Contact:
    """Set-valued Coulomb friction on one body: force f on column `column`, f in [-level_n,
    level_n].

    Sliding f = -level_n sign(v); sticking v = 0 exactly. `velocity` and `position` are the indices
    of the body's states.
    """

    body: str
    velocity: int
    position: int
    level_n: float
    column: int


@dataclass(frozen=True, slots=True)
class Ends:
    """Inelastic ends of the workspace, of the body whose states are `position` and `velocity`."""

    lower_m: float
    upper_m: float
    position: int
    velocity: int


@dataclass(frozen=True, slots=True)
class RotorForce:
    """A nonlinear force F(x, v) on the rotor, added on column `Inputs.rotor_force`.

    `law` is its name in both backends (`model.composed`, `zwidth.engine.source`); `numbers` are its
    parameters in SI units.
    """

    law: str
    numbers: tuple[float, ...]
    position: int
    velocity: int


@dataclass(frozen=True, slots=True)
class DriveLimits:
    """Limits of current and voltage on the motor force, see `model.friction`. `motor_force` and
    `velocity` are states.
    """

    motor_force: int
    velocity: int  # of the rotor
    limit_n: float  # force of the largest current
    stall_n: float  # force of the supply's voltage on a rotor at rest
    shorted_ns_per_m: float  # damping of the winding shorted through the amplifier
    electrical_rad_s: float  # R / L
    amplifier_rad_s: float  # bandwidth of the current


@dataclass(frozen=True, slots=True)
class Noise:
    """White noise of recorded velocity and velocity estimate.

    `velocity_m_per_s` is the rms added to each 4 kHz value of the recorded velocity. `estimate_psd`
    is the one-sided density [(m/s)^2/Hz] of the velocity estimate: a value held for h seconds has
    the variance estimate_psd / (2 h).
    """

    velocity_m_per_s: float = 0.0
    estimate_psd: float = 0.0


@dataclass(frozen=True, slots=True)
class OutputParams:
    """y = (c0 + b c1) x + (d0 + b d1) u of the simulated device, over its states and inputs; b is
    the damping level.
    """

    c0: tuple[float, ...]
    c1: tuple[float, ...]
    d0: tuple[float, ...]
    d1: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class HeatingParams:
    """State of the winding: dT/dt = (R(T) (F/K)^2 R_th - (T - ambient)) / tau, dR = R(T) -
    compensated_ohm.
    """

    resistance_ohm: float  # at reference_c
    reference_c: float
    compensated_ohm: float
    thermal_resistance_k_per_w: float
    time_constant_s: float
    ambient_c: float
    start_c: float


@dataclass(frozen=True, slots=True)
class PlantParams:
    """The composed device of a simulated board: its exact maps over one sub-step, and its nonlinear
    parts.

    n states, m inputs. `maps` contains for every residual resistance and every damping level the n
    rows of [Phi Gamma] (n + m numbers each) one after the other; it is interpolated between the
    nodes.
    """

    states: tuple[str, ...]
    # command, torque, then, if present, estimate, rotor_force, amplifier and one per contact
    columns: tuple[str, ...]
    floating: bool  # the device is not fixed to the ground: only differences of positions matter
    levels_ns_per_m: tuple[float, ...]  # rising, from 0
    residuals_ohm: tuple[float, ...]  # rising; one, if the winding's temperature does not change
    maps: tuple[tuple[float, ...], ...]
    encoder: OutputParams
    travel: OutputParams  # its differences over the 4 kHz interval are the recorded velocity
    impulse: OutputParams | None  # its differences are added to the recorded torque
    motor_force: OutputParams
    estimate: OutputParams
    contacts: tuple[Contact, ...] = ()
    ends: Ends | None = None
    rotor_forces: tuple[RotorForce, ...] = ()
    drive: DriveLimits | None = None
    noise: Noise | None = None
    estimate_offset_m_per_s: float = 0.0
    heating: HeatingParams | None = None


@dataclass(frozen=True, slots=True)
class HandParams(TableParams):
    """One touch of the simulated handle by a hand."""

    kind: Literal["hold", "push", "strike"]
    start_s: NotNegative = 0.0
    """Time after the first frame."""
    duration_s: Positive = 1e9
    force_n: float = 0.0
    """Force of a push; peak of a strike."""
    stiffness_n_per_m: NotNegative = 0.0
    """Stiffness of a hold."""
    damping_ns_per_m: NotNegative = 0.0
    """Damping of a hold."""
    tremor_m: NotNegative = 0.0
    """rms wander of the point of a hold."""


@dataclass(frozen=True, slots=True)
class TouchParams(TableParams):
    """Contacts of the moving part of the simulated device, in addition to its motor; seeded by
    `seed`.
    """

    stop_stiffness_n_per_m: NotNegative = 0.0
    """0: inelastic stops."""
    stop_damping_ns_per_m: NotNegative = 0.0
    coulomb_n: NotNegative = 0.0
    """Added to the device's own friction at the rotor."""
    static_n: NotNegative = 0.0
    """Static value of that friction; at least coulomb_n."""
    hands: Annotated[tuple[HandParams, ...], Constraints(strict=False)] = ()


@dataclass(frozen=True, slots=True)
class BusParams(TableParams):
    """A model of full-speed USB behind an xHCI controller; its times are model values."""

    # `sim.bus` has the source of each number
    transfer: Literal["bulk", "interrupt"] = "bulk"  # of both endpoints
    bit_stuffing: Annotated[float, Constraints(ge=0, le=1)] = 0.0
    """Share of the worst case."""
    nak_us: Annotated[float, Constraints(ge=1, le=1000)] = 16.0
    """Time after a NAK until the controller polls a bulk IN again."""
    hub_microframes: Annotated[int, Constraints(ge=0, le=2)] = 0
    """Additional microframes each way behind a high-speed hub; 0: a root port."""
    moderation_us: Annotated[float, Constraints(ge=0, le=10_000)] = 40.0
    """Shortest time between two interrupts of the controller."""
    frame_ppm: Annotated[float, Constraints(ge=-1000, le=1000)] = 0.0
    """Difference by which the clock of the frames is slower than that of the host."""
    periodic_us: Annotated[float, Constraints(ge=0, le=800)] = 0.0
    """Part of each frame taken by periodic transfers of other devices."""
    busy: Annotated[float, Constraints(ge=0, le=1)] = 0.0
    """Share of transfers that find a packet of another device on the wire."""
    submit_us: Microseconds = 8.0
    """Mean cost of a submission."""
    complete_us: Microseconds = 12.0
    """Mean time from the interrupt until the kernel has completed a transfer."""
    wake_us: Microseconds = 15.0
    """Mean time until a thread waiting for a transfer runs."""


def _said(description: str) -> dict[str, str]:
    """Return a description in place of an attribute docstring, which pydantic does not find in a
    base class.
    """
    return {"description": description}


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardTraits(TableParams):
    """Properties of the simulated board's firmware and its place on the bus, from [simulation];
    each default is a board without defects.
    """

    watchdog_ms: Annotated[float, Constraints(ge=1, le=10_000)] = 250.0
    seed: Annotated[int, Constraints(ge=0)] = 1
    in_queue_depth: Annotated[int, Constraints(ge=0, le=4)] = field(
        default=0,
        metadata=_said(
            "IN packets that wait in the board until they are read; 0: the next one replaces it."
        ),
    )
    board_time_us: Annotated[int, Constraints(ge=0, lt=2**32)] = field(
        default=0,
        metadata=_said(
            "At which the board's time begins when it is powered up; it wraps at 2^32 us."
        ),
    )
    out_transport_us: Annotated[float, Constraints(ge=0, le=10_000)] = field(
        default=0.0,
        metadata=_said("How long a written packet is on its way to the board."),
    )
    in_transport_us: Annotated[float, Constraints(ge=0, le=10_000)] = field(
        default=0.0,
        metadata=_said("How long a packet of the board is on its way to the host."),
    )
    bus: BusParams | None = field(
        default=None,
        metadata=_said("In place of these two times: a model of the bus; left out: none."),
    )
    emergency_stop_bounce_ms: Annotated[float, Constraints(ge=0, le=100)] = field(
        default=0.0,
        metadata=_said(
            "For how long the contact of the emergency stop bounces when it is pressed or released."
        ),
    )
    rights_s: Annotated[float, Constraints(ge=0, le=3600)] = field(
        default=0.0,
        metadata=_said("After it is plugged in until it may be opened, as while udev works."),
    )
    hello_s: Annotated[float, Constraints(ge=0, le=3600)] = field(
        default=0.0,
        metadata=_said("After it is plugged in until it answers requests."),
    )
    boot_loader_s: Annotated[float, Constraints(ge=0, le=3600)] = field(
        default=0.0,
        metadata=_said(
            "After it is plugged in during which it is its boot loader, which stalls requests."
        ),
    )
    injections: Annotated[tuple[InjectionParams, ...], Constraints(strict=False)] = ()
    touch: TouchParams | None = field(
        default=None,
        metadata=_said("Stops that yield, a bearing that sticks, hands; left out: none of them."),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardParams(BoardTraits):
    """All parameters of the simulated board (board.json): nominal scales of its firmware and the
    plant's numbers.
    """

    serial: str
    rate_hz: float
    position_m_per_count: float
    force_n_per_count: float
    active_damping_ns_per_m_per_count: float
    probe_torque_n_per_count: float
    probe_velocity_m_per_s_per_count: float
    current_a_per_count: float
    voltage_v_per_count: float
    force_limit_n: float
    mass_kg: float  # device and probe
    viscous_ns_per_m: float
    lower_stop_m: float
    upper_stop_m: float
    torque_constant_n_per_a: float
    winding_ohm: float
    ambient_c: float
    sample_phase: float = 0.875
    emf_velocity_m_per_s_per_count: float = 2.0 / 32767
    temperature_c_per_count: float = 0.01
    lag_periods: int = (
        0  # whole periods of transport delay between the receipt of a torque and its effect
    )
    plant: PlantParams | None = None  # the composed device; None: one rigid mass
    hello_serial: str = ""  # serial number in the hello reply; empty: `serial`
    lacks: tuple[str, ...] = ()  # missing capabilities: "probe", "event"
    # signed ohm that the resistance DAC adds at 32767 counts; 0: not connected
    trim_full_scale_ohm: float = 0.0


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
class ModelParams:
    """The part of a composed device (`model.model.Model`) that judgements need; n
    states, m inputs.
    """

    name: str
    rate_hz: float
    delay_periods: float  # from the encoder sample to its command, without the hold
    states: tuple[str, ...]  # n names; names of positions end in _position
    a0: tuple[tuple[float, ...], ...]  # n rows of n
    a1: tuple[tuple[float, ...], ...]  # n rows of n, per N s/m of active damping
    b0: tuple[tuple[float, ...], ...]  # n rows of m
    b1: tuple[tuple[float, ...], ...]  # n rows of m, per N s/m of active damping
    command: int  # column of the virtual force
    torque: int  # column of the probe's force
    encoder: OutputParams
    position: OutputParams
    velocity: OutputParams
    recorded_velocity: OutputParams
    recorded_travel: OutputParams
    recorded_impulse: OutputParams | None
    contacts: tuple[Contact, ...] = ()


@dataclass(frozen=True, slots=True)
class MeasuredLevel:
    """Axis limits that a bench found at one active damping: each of K, B, M alone, the others 0. A
    limit is the end of its interval that is nearer to 0; 0 if it was not measured.
    """

    active_damping_ns_per_m: float  # active damping
    stiffness_n_per_m: float  # largest K
    virtual_damping_low_ns_per_m: float  # smallest B
    virtual_damping_high_ns_per_m: float  # largest B
    mass_low_kg: float  # smallest M
    mass_high_kg: float  # largest M


@dataclass(frozen=True, slots=True)
class MeasuredParams:
    """The content of a .zwidth file for this device, or why it may not be used."""

    file: str
    refused: str  # why not; empty: it may be used
    corners_hz: tuple[float, ...] = ()  # of the filters of velocity and acceleration
    psd_n2_per_hz: float = 0.0  # of the perturbation under which it was measured
    levels: tuple[MeasuredLevel, ...] = ()  # rising


@dataclass(frozen=True, slots=True)
class GuardSetup:
    """guard.json: all parameters of the guard's worker."""

    guard: GuardParams
    config_hash: str  # of the judged servo
    environment: Environment  # for the discretisation of its filters
    active_damping_ns_per_m: float  # level of `damping on`
    active_damping_limit_ns_per_m: float  # limit of the damping circuit, from the device file
    active_damping_count_ns_per_m: float  # one count of its DAC
    limits: EnvironmentLimits  # of K, B, M that a client may request
    model: ModelParams | None = None  # None: no model of the device
    model_hash: str = ""
    measured: MeasuredParams | None = None
    psd_n2_per_hz: float = 2.5e-5  # perturbation of the basis `predicted`, one-sided
    band_hz: float = 1700.0  # up to which it is flat


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
