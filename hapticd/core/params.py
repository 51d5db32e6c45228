"""Frozen parameters in SI units, and their JSON form.

`settings` validates TOML with pydantic and hands these down; `servo.json` and `board.json` are
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

from hapticd.core.constraints import (
    Constraints,
    Duration,
    Microseconds,
    NotNegative,
    Positive,
    ServoRateHz,
    TableParams,
)
from hapticd.core.environment import Environment, WorkspaceParams
from hapticd.core.errors import ConfigError
from hapticd.core.units import round_half_up

__all__ = [
    "ACTIVE_DAMPING_NS_PER_M",
    "CALIBRATION_DAYS",
    "COMMISSIONING_SHARE",
    "ENERGY_LIMIT_J",
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
    "MeasuredBy",
    "MeasuredLevel",
    "MeasuredParams",
    "ModelParams",
    "Noise",
    "OutputParams",
    "PlantParams",
    "Policy",
    "RealtimeParams",
    "ResistanceParams",
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

# words of the guard and of leases, as files, messages and commands have them (docs/guard.md)
Policy = Literal["off", "warn", "clamp", "refuse", "follow"]
BasisName = Literal["theorem", "predicted", "measured"]
DampingMode = Literal["off", "level", "auto"]
Leased = Literal["environment", "active_damping", "perturbation", "measuring"]
AtEnd = Literal["hold", "zero", "disable"]
STRICT_POLICIES = frozenset({"clamp", "refuse", "follow"})  # what is unknown is refused

ENERGY_LIMIT_J = 0.02  # of an 8 g handle at 2.2 m/s; see ADR-0014
RAMP_ENERGY_J = 0.03  # K = 600 N/m brought in 10 mm off; see ADR-0013
COMMISSIONING_SHARE = 0.1  # of the device's force, until its signs are verified; see ADR-0029
CALIBRATION_DAYS = 365  # see ADR-0029
SHORTEST_LEASE_S = 0.2  # twenty passes of the gateway
LONGEST_LEASE_S = 60.0
LONGEST_TIMEOUT_MS = 5  # of a transfer, for which docs/safety.md says when force is gone
LAST_TICK = 10**12  # of an injection: 30 years at 1 kHz
ACTIVE_DAMPING_NS_PER_M = 1.74  # what `damping on` means: Weir, Colgate and Peshkin 2008, section 5


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
MeasuredBy = Literal[RigStep, "paper", ""]
# between a measured scale and the board's nominal one; more is a wrong unit, range or board
MOST_CORRECTION = 1.5


@dataclass(frozen=True, slots=True)
class ScaleParams:
    """value = sign * (count - offset_count) * per_count, and where that comes from."""

    per_count: float
    sign: int = 1
    offset_count: float = 0.0
    half_width_95: float | None = None  # of the 95 % interval of per_count; None: unknown
    measured_on: str = ""  # ISO date
    measured_by: str = ""  # a `MeasuredBy`
    serial: str = ""  # of the board at which it was measured; "": that of the device file
    source: str = ""  # in words

    @property
    def measured(self) -> bool:
        """Whether a step of `hapticd rig` measured it."""
        return self.measured_by in RIG_STEPS

    def to_value(self, count: float) -> float:
        """SI value of `count`."""
        return self.sign * (count - self.offset_count) * self.per_count

    def to_count(self, value: float, low: int, high: int) -> int:
        """Nearest count for a finite SI `value`, held inside `low`..`high`."""
        return max(
            low, min(high, round_half_up(self.sign * value / self.per_count + self.offset_count))
        )


@dataclass(frozen=True, slots=True)
class HomeParams(TableParams):
    """How the origin of position is found."""

    method: Literal["none", "stop", "index"] = "none"
    required: bool = False
    """Refuse to enable before it was done."""
    direction: Literal[-1, 1] = -1
    speed_m_per_s: Annotated[float, Constraints(gt=0, le=1)] = 0.01
    force_n: Positive = 0.5
    position_m: float = 0.0
    """Where the stop or index lies."""
    timeout_s: Annotated[float, Constraints(gt=0, le=600)] = 10.0
    tolerance_m: Annotated[float, Constraints(gt=0, le=0.01)] = 50e-6
    """Between the two finds, and what a stop may yield under half the push."""
    back_off_m: Annotated[float, Constraints(gt=0, le=0.1)] = 2e-3
    """Way between the two finds; at least eight times the tolerance."""
    current_n_per_a: NotNegative = 0.0
    """Endpoint force per ampere of the motor; 0: its current is not looked at."""


@dataclass(frozen=True, slots=True)
class ResistanceParams:
    """How a board compensates the winding's resistance, and what is known of the winding
    (render.winding). The circuit believes in base_ohm + trim.
    """

    trim: ScaleParams  # ohm beyond base_ohm that a count of the DAC adds
    full_scale_ohm: float  # that 32767 counts add
    base_ohm: float  # that the circuit compensates at count 0
    winding_ohm: float  # of the winding at reference_c
    reference_c: float
    per_k: float  # relative change of its resistance
    tolerance_ohm: float  # by which less than the winding has is compensated
    slew_ohm_per_s: float  # of the trim
    force_n_per_a: float  # endpoint force per ampere of the motor
    heat_from: str  # what tells how the winding is heated: "current" | "force"
    thermal_resistance_k_per_w: float  # winding to surroundings
    time_constant_s: float  # of the winding against its surroundings
    ambient_low_c: float  # the surroundings are never colder,
    ambient_high_c: float  # and never hotter
    model_error: float  # share by which thermal resistance and time constant may be wrong


@dataclass(frozen=True, slots=True)
class EnvironmentLimits:
    """Lowest and highest K [N/m], B [N s/m] and M [kg] that a client may ask for."""

    lowest: tuple[float, ...]
    highest: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class DeviceParams:
    """A device file: what one count means on this very device, and what it may be asked for."""

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
    speed_limit_m_per_s: float  # faster is not a motion but a sensor fault
    home: HomeParams = HomeParams()
    # capabilities of the board without which the device may not be used: "probe", "temperature"
    relies_on: tuple[str, ...] = ()
    # corner of a first-order low-pass on the commanded force, where a model knows it; 0: none
    force_smoothing_hz: float = 0.0
    overspeed_m_per_s: float | None = None  # faster for some ms is a fault; None: not looked at
    # N s/m that the device has for certain, from its file; None: unknown, no fault `energy`
    physical_damping_ns_per_m: float | None = None
    energy_limit_j: float = ENERGY_LIMIT_J  # that may be given away without cover: fault `energy`
    # largest step of force [N] in one tick by an enable or a change of parameters; infinite: any
    force_step_n: float = math.inf
    # faster change of speed is believed only when the next sample goes on from it (servo.glitch)
    acceleration_limit_m_per_s2: float = math.inf
    # that enables and changes of parameters may bring in within a second (servo.easing)
    ramp_energy_j: float = math.inf
    resistance: ResistanceParams | None = None  # None: the board's compensation stays at count 0
    motor_n_per_a: float = 0.0  # force at the endpoint per ampere, from the device file; 0: unknown
    winding_ohm: float = 0.0  # at `winding_reference_c`, from the device file; 0: unknown
    winding_reference_c: float = 20.0
    motor_lever_m: float = 1.0  # radius that turns torque into force, from [motor]; 1: unknown
    # its signs are not verified: little force, a box for K, B and M (servo.commissioning)
    commissioning: bool = False
    signs_firmware: str = ""  # of the board when its signs were seen, like 1.0; "": any
    active_damping_with_force_n: float = (
        0.0  # full scale of force when damping was measured; 0: unknown
    )
    probe_skew_us: float = 0.0  # by which the probe's velocity is later than its force
    calibration_days: int = CALIBRATION_DAYS  # after which a calibration is too old to rely on
    environment_limits: EnvironmentLimits | None = None  # None: those of the mailbox alone

    def temperature_counts(self, low: int, high: int) -> tuple[int, int]:
        """Lowest and highest count, inside `low`..`high`, of a temperature that is allowed: a
        scale of sign -1 counts downwards as the winding gets hot.
        """
        limit = self.temperature.to_count(self.temperature_limit_c, low, high)
        return (low, limit) if self.temperature.sign > 0 else (limit, high)


@dataclass(frozen=True, slots=True)
class SafetyParams(TableParams):
    """Times and levels of the safety table."""

    force_limit_n: Positive | None = None
    """Tighter than the device's own limit; left out: the device's limit."""
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
    """Ramp of a `set` that names none."""
    # a trial at the edge of stability does without
    limit_cycle_faults: bool = True
    """Faults force_at_limit and energy."""
    energy_controller: bool = False
    """More active damping, then less of K, B, M and walls, before the fault `energy`."""


@dataclass(frozen=True, slots=True)
class RealtimeParams(TableParams):
    """What the servo process asks of the operating system."""

    rate_hz: ServoRateHz = 1000.0
    mode: Literal["strict", "best_effort", "off"] = "best_effort"
    """strict: refuse to start without the rights; best_effort: take what is granted, report it."""
    priority: Annotated[int, Constraints(ge=1, le=99)] = 79
    core: Annotated[int, Constraints(ge=0)] | None = None
    """Left out: the last core that this process may use."""
    spin_us: Annotated[float, Constraints(ge=0, le=10_000)] = 100.0
    """Busy waiting before each deadline."""
    lock_memory: bool = True
    grace_s: Duration = 1.0
    """Overruns right after the start are counted apart for this long."""


@dataclass(frozen=True, slots=True)
class UsbTable(TableParams):
    """Which board; its serial number stands in the device file."""

    vendor_id: Annotated[int, Constraints(ge=0, le=0xFFFF)] = 0x1209
    product_id: Annotated[int, Constraints(ge=0, le=0xFFFF)] = 0x0001
    # the schema names the limit, `settings.load` refuses with the reason for it
    timeout_ms: Annotated[int, Constraints(ge=1)] = field(
        default=1, metadata={"json_schema_extra": {"maximum": LONGEST_TIMEOUT_MS}}
    )
    """Of one transfer. A silent board may delay the end of force by one."""
    in_flight: bool = False
    """Transfers go on while the servo computes, so the force acts earlier."""


@dataclass(frozen=True, slots=True)
class UsbParams(UsbTable):
    """Which board: None matches any."""

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
    device_file: str = ""  # from which `device` was read; "": from none
    device_file_sha256: str = ""  # of its bytes then

    def __post_init__(self) -> None:
        if self.safety.force_limit_n is None:
            safety = replace(self.safety, force_limit_n=self.device.force_limit_n)
            object.__setattr__(self, "safety", safety)  # the way of a frozen dataclass

    @property
    def force_limit_n(self) -> float:
        """The most that may be commanded [N]: by configuration and device, and a tenth of the
        device's until its signs are verified.
        """
        share = COMMISSIONING_SHARE if self.device.commissioning else 1.0
        device_n = share * self.device.force_limit_n
        asked_n = self.safety.force_limit_n
        return device_n if asked_n is None else min(asked_n, device_n)

    @property
    def soft_ends(self) -> WorkspaceParams:
        """The soft ends of the workspace; without springs until the signs of the device are
        verified, since nobody knows on which side they lie.
        """
        ends = self.environment.workspace
        return replace(ends, stiffness_n_per_m=0.0) if self.device.commissioning else ends


@dataclass(frozen=True, slots=True)
class InjectionParams(TableParams):
    """One seeded fault of the simulated board."""

    kind: Annotated[str, Constraints(min_length=1)]
    tick: Annotated[int, Constraints(ge=-1, le=LAST_TICK)] = -1
    """At this tick; -1: by probability."""
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
    """A force F(x, v) on the rotor that is not linear, added on column `Inputs.rotor_force`.

    `law` names it in both backends (`model.composed`, `zwidth.engine.source`); `numbers` are its
    parameters in SI units.
    """

    law: str
    numbers: tuple[float, ...]
    position: int
    velocity: int


@dataclass(frozen=True, slots=True)
class DriveLimits:
    """Limits of current and voltage on the motor force, see `model.drive`. `motor_force` and
    `velocity` are states.
    """

    motor_force: int
    velocity: int  # of the rotor
    limit_n: float  # force of the largest current
    stall_n: float  # force that the supply's voltage holds on a rotor that stands
    shorted_ns_per_m: float  # damping of the winding shorted through the amplifier
    electrical_rad_s: float  # R / L
    amplifier_rad_s: float  # bandwidth of the current


@dataclass(frozen=True, slots=True)
class Noise:
    """White noise: `velocity_m_per_s` rms added to each 4 kHz value of the recorded velocity;
    `estimate_psd` one-sided density [(m/s)^2/Hz] of the velocity estimate (a value held for h
    seconds has the variance estimate_psd / (2 h)).
    """

    velocity_m_per_s: float = 0.0
    estimate_psd: float = 0.0


@dataclass(frozen=True, slots=True)
class OutputParams:
    """y = (c0 + b c1) x + (d0 + b d1) u of the simulated device, over its states and inputs; b
    is the damping level.
    """

    c0: tuple[float, ...]
    c1: tuple[float, ...]
    d0: tuple[float, ...]
    d1: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class HeatingParams:
    """The winding's own state: dT/dt = (R(T) (F/K)^2 R_th - (T - ambient)) / tau, dR = R(T) -
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
    """The composed device of a simulated board: its exact maps over one sub-step, and what is not
    linear.

    n states, m inputs. `maps` holds for every residual resistance, and in it for every damping
    level, the n rows of [Phi Gamma] (n + m numbers each) one after the other; between the nodes it
    is interpolated.
    """

    states: tuple[str, ...]
    # command, torque, then estimate, rotor_force, amplifier and one per contact, as far as there
    # are any
    columns: tuple[str, ...]
    floating: bool  # nothing holds the device in place: only differences of positions matter
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
    """After the first frame."""
    duration_s: Positive = 1e9
    force_n: float = 0.0
    """Of a push; highest of a strike."""
    stiffness_n_per_m: NotNegative = 0.0
    """Of a hold."""
    damping_ns_per_m: NotNegative = 0.0
    """Of a hold."""
    tremor_m: NotNegative = 0.0
    """rms wander of the point at which it holds."""


@dataclass(frozen=True, slots=True)
class TouchParams(TableParams):
    """What touches the moving part of the simulated device beside its motor; seeded by `seed`."""

    stop_stiffness_n_per_m: NotNegative = 0.0
    """0: inelastic stops."""
    stop_damping_ns_per_m: NotNegative = 0.0
    coulomb_n: NotNegative = 0.0
    """Added to the device's own friction at the rotor."""
    static_n: NotNegative = 0.0
    """That friction while the rotor stands; at least coulomb_n."""
    hands: Annotated[tuple[HandParams, ...], Constraints(strict=False)] = ()


@dataclass(frozen=True, slots=True)
class BusParams(TableParams):
    """A model of full-speed USB behind an xHCI controller; times that it gives are those of a
    model.
    """

    # `sim.bus` has the source of each number
    transfer: Literal["bulk", "interrupt"] = "bulk"  # of both endpoints
    bit_stuffing: Annotated[float, Constraints(ge=0, le=1)] = 0.0
    """Share of the worst case."""
    nak_us: Annotated[float, Constraints(ge=1, le=1000)] = 16.0
    """After a NAK until the controller asks a bulk IN again."""
    hub_microframes: Annotated[int, Constraints(ge=0, le=2)] = 0
    """More each way behind a high-speed hub; 0: a root port."""
    moderation_us: Annotated[float, Constraints(ge=0, le=10_000)] = 40.0
    """Shortest time between two interrupts of the controller."""
    frame_ppm: Annotated[float, Constraints(ge=-1000, le=1000)] = 0.0
    """By which the clock of the frames is slower than that of the host."""
    periodic_us: Annotated[float, Constraints(ge=0, le=800)] = 0.0
    """Of each frame, taken by periodic transfers of other devices."""
    busy: Annotated[float, Constraints(ge=0, le=1)] = 0.0
    """Share of transfers that find a packet of another device on the wire."""
    submit_us: Microseconds = 8.0
    """Mean cost of a submission."""
    complete_us: Microseconds = 12.0
    """Mean time from the interrupt until the kernel has completed a transfer."""
    wake_us: Microseconds = 15.0
    """Mean time until a thread runs that waited for a transfer."""


def _said(description: str) -> dict[str, str]:
    """What would be an attribute docstring; pydantic finds none of a base class."""
    return {"description": description}


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardTraits(TableParams):
    """What the simulated board's firmware and its place on the bus are like, as [simulation] says
    it; each default is a board that does what it should.
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
    """Everything the simulated board needs (board.json): nominal scales of its firmware and the
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
    plant: PlantParams | None = None  # the composed device; without it one rigid mass
    hello_serial: str = ""  # serial number in the hello reply; empty: `serial`
    lacks: tuple[str, ...] = ()  # capabilities that it does not have: "probe", "event"
    # ohm that the resistance DAC adds at 32767 counts, with its sign; 0: it is not connected
    trim_full_scale_ohm: float = 0.0


@dataclass(frozen=True, slots=True)
class GatewayParams(TableParams):
    """Where telemetry is offered. Commands are taken on a socket in the runtime folder."""

    telemetry_port: Annotated[int, Constraints(ge=0, le=65_535)] = 9872  # PlotJuggler's default
    """0, or a port that is taken: any free one."""
    batch: Annotated[int, Constraints(ge=1, le=1000)] = 20
    """Ticks in one `servo` message."""
    tcp_host: Annotated[str, Constraints(min_length=1)] = "127.0.0.1"
    allow_insecure: bool = False
    """Offer telemetry beyond this machine without keys."""
    curve_keys: str | None = None
    """Folder with the server's key and those of allowed clients."""
    flight_s: Annotated[float, Constraints(gt=0, le=600)] = 60.0
    """What the flight recorder keeps, at every tick."""


@dataclass(frozen=True, slots=True)
class GuardTable(TableParams):
    """What is done with an environment that is not known to be passive."""

    policy: Policy | None = None
    """Left out: `refuse` on hardware whose device file has a [model], else `warn`."""
    basis: BasisName = "theorem"
    """theorem: for any input and hand; predicted: with friction, at the amplitude of a trial;
    measured: what the file `measured` says.
    """
    measured: str | None = None
    """A .zwidth file of this device; beside this file if relative."""
    margin_ns_per_m: Annotated[float, Constraints(ge=0, le=100)] = 0.0
    """That has to be left for an environment to be allowed."""


@dataclass(frozen=True, slots=True)
class GuardParams(GuardTable):
    """The same with what this device has where it was left out; no file is ""."""

    policy: Policy = "warn"
    measured: str = ""


@dataclass(frozen=True, slots=True)
class LeaseParams(TableParams):
    """What a client that takes a lease has, unless it asks for something else."""

    ttl_s: Annotated[float, Constraints(ge=SHORTEST_LEASE_S, le=LONGEST_LEASE_S)] = 5.0
    """A lease ends when its holder asked nothing for so long."""
    at_end: AtEnd = "zero"
    """When its holder dies or falls silent. zero: K, B and M, if they were leased, go to 0 on a
    ramp; disable: force off; hold: all stays. Active damping stays in any case.
    """


@dataclass(frozen=True, slots=True)
class ModelParams:
    """What a judgement needs of a composed device (`model.model.Model`), n states, m inputs."""

    name: str
    rate_hz: float
    delay_periods: float  # from the encoder sample to its command, without the hold
    states: tuple[str, ...]  # n names; those of positions end in _position
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
    """Axis limits that a bench found at one active damping: each of K, B, M alone, the others 0,
    by the end of its interval that is nearer to 0; 0 where none was looked for.
    """

    active_damping_ns_per_m: float  # active damping
    stiffness_n_per_m: float  # largest K
    virtual_damping_low_ns_per_m: float  # least B
    virtual_damping_high_ns_per_m: float  # largest B
    mass_low_kg: float  # least M
    mass_high_kg: float  # largest M


@dataclass(frozen=True, slots=True)
class MeasuredParams:
    """What a .zwidth file says of this device, or why it may not be used."""

    file: str
    refused: str  # why not; empty: it may be used
    corners_hz: tuple[float, ...] = ()  # of the filters of velocity and acceleration
    psd_n2_per_hz: float = 0.0  # of the perturbation under which it was measured
    levels: tuple[MeasuredLevel, ...] = ()  # rising


@dataclass(frozen=True, slots=True)
class GuardSetup:
    """guard.json: everything that the guard's worker needs."""

    guard: GuardParams
    config_hash: str  # of the servo that it judges for
    environment: Environment  # its filters' way of being made discrete
    active_damping_ns_per_m: float  # what `damping on` means
    active_damping_limit_ns_per_m: float  # ceiling of the damping circuit, by the device file
    active_damping_count_ns_per_m: float  # one count of its DAC
    limits: EnvironmentLimits  # of K, B, M that a client may ask for
    model: ModelParams | None = None  # None: nothing is known of the device
    model_hash: str = ""
    measured: MeasuredParams | None = None
    psd_n2_per_hz: float = 2.5e-5  # perturbation of the basis `predicted`, one-sided
    band_hz: float = 1700.0  # up to which it is flat


@dataclass(frozen=True, slots=True)
class GatewaySetup:
    """gateway.json: the gateway's own parameters, and the servo's for the limits and scales it
    checks against.
    """

    servo: ServoParams
    gateway: GatewayParams = GatewayParams()
    guard: GuardParams = GuardParams()
    lease: LeaseParams = LeaseParams()


def to_plain(value: Any) -> Any:
    """Dataclass tree -> dicts and lists that json writes."""
    return dataclasses.asdict(value)


def from_plain(kind: type[T], plain: Any, where: str = "") -> T:
    """Dicts and lists -> dataclass tree of type `kind`. Raises ConfigError with the path of a
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
    """The parameters of `kind` in the JSON file `path`. ConfigError names the file."""
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
