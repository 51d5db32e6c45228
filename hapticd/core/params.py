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
from typing import Any, Literal, TypeVar, get_args

from hapticd.core.environment import Environment, WorkspaceParams
from hapticd.core.errors import ConfigError
from hapticd.core.units import round_half_up

__all__ = [
    "ACTIVE_DAMPING_NS_PER_M",
    "CALIBRATION_DAYS",
    "COMMISSIONING_SHARE",
    "ENERGY_LIMIT_J",
    "LONGEST_LEASE_S",
    "MOST_CORRECTION",
    "RAMP_ENERGY_J",
    "RIG_STEPS",
    "SHORTEST_LEASE_S",
    "STRICT_POLICIES",
    "AtEnd",
    "BasisName",
    "BoardParams",
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

ENERGY_LIMIT_J = 0.02  # of an 8 g handle at 2.2 m/s; see ADR 0085
RAMP_ENERGY_J = 0.03  # K = 600 N/m brought in 10 mm off; see ADR 0106
COMMISSIONING_SHARE = 0.1  # of the device's force, until its signs are verified; see ADR 0115
CALIBRATION_DAYS = 365  # see ADR 0124
SHORTEST_LEASE_S = 0.2  # twenty passes of the gateway
LONGEST_LEASE_S = 60.0
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
class HomeParams:
    """How the position origin is found: `none`, against a `stop` at bounded force, or at the
    encoder `index`.
    """

    method: str = "none"
    required: bool = False
    direction: int = -1
    speed_m_per_s: float = 0.01
    force_n: float = 0.5
    position_m: float = 0.0  # where the stop or index lies
    timeout_s: float = 10.0
    tolerance_m: float = 50e-6  # between two finds, and what a stop may yield under half the push
    back_off_m: float = 2e-3  # travelled freely before the second find
    current_n_per_a: float = 0.0  # endpoint force per motor current; 0: current is not checked


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
class SafetyParams:
    """Times and levels of the safety table."""

    force_limit_n: float = 8.0
    enable_ramp_s: float = 0.5
    stop_ramp_s: float = 0.02
    active_damping_hold_s: float = 2.0
    active_damping_release_s: float = 0.5
    safe_active_damping_ns_per_m: float = 0.0
    active_damping_slew_ns_per_m_s: float = 20.0
    gateway_timeout_s: float = 1.0
    on_gateway_loss: str = "fault"  # "fault" | "hold"
    lost_slots_limit: int = 10  # within one second
    missing_frames_limit: int = 8
    no_authority_limit: int = 8  # periods for which the board may withhold torque while enabled
    glitches_limit: int = 2  # of the encoder within one second
    default_ramp_s: float = 0.05
    # faults force_at_limit and energy, which a trial at the edge of stability does without
    limit_cycle_faults: bool = True
    energy_controller: bool = False  # servo.energy_controller


@dataclass(frozen=True, slots=True)
class RealtimeParams:
    """What the servo process asks of the operating system."""

    rate_hz: float = 1000.0
    # "strict": refuse to start without the rights | "best_effort": report what was granted | "off"
    mode: str = "best_effort"
    priority: int = 79
    core: int | None = None  # None: the last one of those allowed
    spin_us: float = 100.0
    lock_memory: bool = True
    grace_s: float = 1.0  # start-up overruns are counted apart for this long


@dataclass(frozen=True, slots=True)
class UsbParams:
    """Which board: None matches any."""

    vendor_id: int = 0x1209
    product_id: int = 0x0001
    serial: str | None = None
    timeout_ms: int = 1  # of one transfer; what libusb can do least
    in_flight: bool = False  # transfers under way while the servo computes


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

    @property
    def force_limit_n(self) -> float:
        """The most that may be commanded [N]: by configuration and device, and a tenth of the
        device's until its signs are verified.
        """
        share = COMMISSIONING_SHARE if self.device.commissioning else 1.0
        return min(self.safety.force_limit_n, share * self.device.force_limit_n)

    @property
    def soft_ends(self) -> WorkspaceParams:
        """The soft ends of the workspace; without springs until the signs of the device are
        verified, since nobody knows on which side they lie.
        """
        ends = self.environment.workspace
        return replace(ends, stiffness_n_per_m=0.0) if self.device.commissioning else ends


@dataclass(frozen=True, slots=True)
class InjectionParams:
    """One seeded fault of the simulated board: at `tick` (or with `probability` each tick),
    `count` times.
    """

    kind: str
    tick: int = -1
    probability: float = 0.0
    count: int = 1
    value: float = 0.0


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
class HandParams:
    """One touch of the simulated handle by a hand: it holds, pushes or strikes (`model.touch`)."""

    kind: str  # "hold" | "push" | "strike"
    start_s: float = 0.0  # after the device's first movement in time, s
    duration_s: float = 1e9
    force_n: float = 0.0  # of a push; highest of a strike
    stiffness_n_per_m: float = 0.0  # of a hold
    damping_ns_per_m: float = 0.0  # of a hold
    tremor_m: float = 0.0  # rms wander of the point at which it holds


@dataclass(frozen=True, slots=True)
class TouchParams:
    """What touches the moving part of a simulated device beside its motor (`model.touch`).

    The default is nothing.
    """

    stop_stiffness_n_per_m: float = 0.0  # 0: the device's own inelastic stops
    stop_damping_ns_per_m: float = 0.0
    coulomb_n: float = 0.0  # added to the device's own friction at the rotor
    static_n: float = 0.0  # that friction while the rotor stands; coulomb_n or more
    hands: tuple[HandParams, ...] = ()


@dataclass(frozen=True, slots=True)
class BusParams:
    """A full-speed bus behind an xHCI controller; `sim.bus` has the source of each number."""

    transfer: str = "bulk"  # or "interrupt": of both endpoints
    bit_stuffing: float = 0.0  # share of the worst case, 0..1
    nak_us: float = 16.0  # after a NAK until the controller asks a bulk IN again
    hub_microframes: int = 0  # more each way behind a high-speed hub; 0: a root port
    moderation_us: float = 40.0  # shortest time between two interrupts of the controller
    frame_ppm: float = 0.0  # by which the clock of the frames is slower than that of the host
    periodic_us: float = 0.0  # of each frame, from its start on: other devices' periodic transfers
    busy: float = 0.0  # share of transfers that find a packet of another device on the wire
    submit_us: float = 8.0  # mean: from the call until the controller knows of the transfer
    complete_us: float = 12.0  # mean: from the interrupt until the kernel has completed it
    wake_us: float = 15.0  # mean: until a thread that waits for it runs


@dataclass(frozen=True, slots=True)
class BoardParams:
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
    watchdog_ms: float = 250.0
    seed: int = 1
    injections: tuple[InjectionParams, ...] = field(default_factory=tuple)
    emf_velocity_m_per_s_per_count: float = 2.0 / 32767
    temperature_c_per_count: float = 0.01
    lag_periods: int = (
        0  # whole periods of transport delay between the receipt of a torque and its effect
    )
    plant: PlantParams | None = None  # the composed device; without it one rigid mass
    # --- what makes the board unkind; each default is a board that does what it should ------------
    in_queue_depth: int = 0  # IN packets that its endpoint holds, 1..4; 0: the next replaces
    board_time_us: int = 0  # at which board time begins whenever it is powered up
    out_transport_us: float = 0.0  # from the host's write until the board has the OUT
    in_transport_us: float = 0.0  # from the board's IN, or the host's read, until the host has it
    bus: BusParams | None = None  # in place of these two: a model of full speed
    touch: TouchParams | None = None  # what touches its rotor beside the motor
    emergency_stop_bounce_ms: float = 0.0  # of its contact, at either edge
    hello_serial: str = ""  # serial number in the hello reply; empty: `serial`
    lacks: tuple[str, ...] = ()  # capabilities that it does not have: "probe", "event"
    rights_s: float = 0.0  # after a plug until udev has granted the rights to open it
    hello_s: float = 0.0  # after a plug until it answers requests
    boot_loader_s: float = 0.0  # after a plug in its boot loader, until it comes back as itself
    # ohm that the resistance DAC adds at 32767 counts, with its sign; 0: it is not connected
    trim_full_scale_ohm: float = 0.0


@dataclass(frozen=True, slots=True)
class GatewayParams:
    """What the gateway process needs (gateway.json): where telemetry is offered and how many
    ticks share a message.
    """

    telemetry_port: int = 9872  # PlotJuggler's default; an ephemeral one when taken
    batch: int = 20  # ticks in one `servo` message
    tcp_host: str = "127.0.0.1"
    allow_insecure: bool = False  # another host than the loopback without CURVE keys
    curve_keys: str | None = None  # folder of server key and allowed client keys
    flight_s: float = 60.0  # kept by the flight recorder


@dataclass(frozen=True, slots=True)
class GuardParams:
    """What the guard does with an environment that is not known to be passive, and how it knows."""

    policy: str = "warn"  # a Policy
    basis: str = "theorem"  # a BasisName
    measured: str = ""  # .zwidth file of the basis "measured"
    margin_ns_per_m: float = 0.0  # that has to be left


@dataclass(frozen=True, slots=True)
class LeaseParams:
    """Leases of clients that do not say otherwise."""

    ttl_s: float = 5.0  # without a request, after which one ends
    # what becomes of the environment when its holder dies or falls silent; damping is held
    at_end: str = "zero"  # an AtEnd


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
    rate_hz: float
    environment: Environment  # its filters' way of being made discrete
    active_damping_ns_per_m: float  # what `damping on` means
    active_damping_limit_ns_per_m: float  # ceiling of the damping circuit, by the device file
    active_damping_count_ns_per_m: float  # one count of its DAC
    lowest: tuple[float, ...]  # of K, B, M that a client may ask for
    highest: tuple[float, ...]
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
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return from_plain(hint, plain, where)
    if typing.get_origin(hint) is tuple:
        return tuple(_value(typing.get_args(hint)[0], item, where) for item in plain)
    allowed = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    if isinstance(plain, dict) and len(allowed) == 2 and dataclasses.is_dataclass(allowed[0]):
        return _value(allowed[0], plain, where)
    if float in allowed and isinstance(plain, int) and not isinstance(plain, bool):
        return float(plain)
    if not isinstance(plain, tuple(allowed)) or plain != plain:  # NaN passes every limit
        raise ConfigError(
            f"{where}: expected {hint}, got {plain!r}; resolve the configuration again"
        )
    return plain
