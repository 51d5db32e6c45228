"""hapticd.toml: what is asked of any device.

Defaults come from `core.params`; limits are those of good sense. `load` checks what a device itself
allows.
"""

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, create_model

from hapticd.core.environment import (
    FIELDS,
    STRENGTHS,
    Environment,
    FilterParams,
    WallParams,
    WorkspaceParams,
)
from hapticd.core.params import (
    LONGEST_LEASE_S,
    SHORTEST_LEASE_S,
    AtEnd,
    BasisName,
    BoardParams,
    BusParams,
    GatewayParams,
    GuardParams,
    HandParams,
    LeaseParams,
    Policy,
    RealtimeParams,
    SafetyParams,
    ServoParams,
    TouchParams,
    UsbParams,
)
from hapticd.settings.tables import TomlTable

__all__ = ["Config"]

_environment = Environment()
_wall = WallParams()
_ends = WorkspaceParams()
_safety = SafetyParams()
_realtime = RealtimeParams()
_usb = UsbParams()
_gateway = GatewayParams()
_guard = GuardParams()
_lease = LeaseParams()
_board: Any = BoardParams.__dataclass_fields__
_hand = HandParams("hold")
_touch = TouchParams()
_bus = BusParams()
_active_damping_ns_per_m: Any = ServoParams.__dataclass_fields__["active_damping_ns_per_m"].default

LONGEST_TIMEOUT_MS = 5  # of a transfer, for which docs/safety.md says when force is gone
LAST_TICK = 10**12  # of an injection: 30 years at 1 kHz
Duration = Annotated[float, Field(ge=0, le=60)]


_RANGES: dict[str, Any] = {one.path: {"ge": one.low, "le": one.high} for one in FIELDS}
# numbers of the environment itself; the active damping stands in a table of its own
RENDERED = tuple(one.path for one in STRENGTHS if "." not in one.path)
FrequencyHz = Annotated[float, Field(**_RANGES["velocity_filter.frequency_hz"])]
DampingRatio = Annotated[float, Field(**_RANGES["velocity_filter.damping_ratio"])]


class Filter(TomlTable):
    frequency_hz: FrequencyHz
    """Corner of the second-order low-pass; at most 0.45 of the servo rate."""
    damping_ratio: DampingRatio = FilterParams(1.0).damping_ratio
    """0.7071 is Butterworth."""
    mapping: Literal["prewarped", "bilinear", "matched"] = "prewarped"
    """How the filter is made discrete."""


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
    """How far before each end of travel they begin."""


if TYPE_CHECKING:  # a model that is made of the table is no base for a checker
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
    """What is rendered at start; `hapticd set` changes it live."""

    velocity_filter: Filter = _filter(_environment.velocity_filter)
    acceleration_filter: Filter = _filter(_environment.acceleration_filter)
    wall: WallTable = WallTable()
    workspace: Workspace = Workspace()


class Safety(TomlTable):
    """Times and levels of the safety table."""

    force_limit_n: float | None = Field(None, gt=0)
    """Tighter than the device's own limit; left out: the device's limit."""
    enable_ramp_s: Duration = _safety.enable_ramp_s
    stop_ramp_s: float = Field(_safety.stop_ramp_s, ge=0, le=1)
    active_damping_hold_s: Duration = _safety.active_damping_hold_s
    active_damping_release_s: Duration = _safety.active_damping_release_s
    safe_active_damping_ns_per_m: float = Field(_safety.safe_active_damping_ns_per_m, ge=0)
    """Active damping held after a stop or fault."""
    active_damping_slew_ns_per_m_s: float = Field(
        _safety.active_damping_slew_ns_per_m_s, gt=0, le=1e6
    )
    gateway_timeout_s: float = Field(_safety.gateway_timeout_s, ge=0.2, le=60)
    on_gateway_loss: Literal["fault", "hold"] = "fault"
    lost_slots_limit: int = Field(_safety.lost_slots_limit, ge=1, le=10_000)
    """Ticks that may be missed within one second on hardware."""
    missing_frames_limit: int = Field(_safety.missing_frames_limit, ge=1, le=100)
    no_authority_limit: int = Field(_safety.no_authority_limit, ge=1, le=100)
    glitches_limit: int = Field(_safety.glitches_limit, ge=0, le=1000)
    """Bad encoder samples that may occur within one second."""
    default_ramp_s: Duration = _safety.default_ramp_s
    """Ramp of a `set` that names none."""
    limit_cycle_faults: bool = _safety.limit_cycle_faults
    """Faults force_at_limit and energy."""
    energy_controller: bool = _safety.energy_controller
    """More active damping, then less of K, B, M and walls, before the fault `energy`."""


class Realtime(TomlTable):
    """What the servo process asks of the operating system."""

    rate_hz: float = Field(_realtime.rate_hz, ge=50, le=20_000)
    mode: Literal["strict", "best_effort", "off"] = "best_effort"
    """strict: refuse to start without the rights; best_effort: take what is granted, report it."""
    priority: int = Field(_realtime.priority, ge=1, le=99)
    core: int | None = Field(None, ge=0)
    """Left out: the last core that this process may use."""
    spin_us: float = Field(_realtime.spin_us, ge=0, le=10_000)
    """Busy waiting before each deadline."""
    lock_memory: bool = _realtime.lock_memory
    grace_s: Duration = _realtime.grace_s
    """Overruns right after the start are counted apart for this long."""


class Usb(TomlTable):
    """Which board; its serial number stands in the device file."""

    vendor_id: int = Field(_usb.vendor_id, ge=0, le=0xFFFF)
    product_id: int = Field(_usb.product_id, ge=0, le=0xFFFF)
    timeout_ms: int = Field(
        _usb.timeout_ms, ge=1, json_schema_extra={"maximum": LONGEST_TIMEOUT_MS}
    )
    """Of one transfer. A silent board may delay the end of force by one."""
    in_flight: bool = _usb.in_flight
    """Transfers go on while the servo computes, so the force acts earlier."""


class GatewayTable(TomlTable):
    """Where telemetry is offered. Commands are taken on a socket in the runtime folder."""

    telemetry_port: int = Field(_gateway.telemetry_port, ge=0, le=65_535)
    """0, or a port that is taken: any free one."""
    batch: int = Field(_gateway.batch, ge=1, le=1000)
    """Ticks in one `servo` message."""
    tcp_host: str = Field(_gateway.tcp_host, min_length=1)
    allow_insecure: bool = _gateway.allow_insecure
    """Offer telemetry beyond this machine without keys."""
    curve_keys: str | None = None
    """Folder with the server's key and those of allowed clients."""
    flight_s: float = Field(_gateway.flight_s, gt=0, le=600)
    """What the flight recorder keeps, at every tick."""


class GuardTable(TomlTable):
    """What is done with an environment that is not known to be passive."""

    policy: Policy | None = None
    """Left out: `refuse` on hardware whose device file has a [model], else `warn`."""
    basis: BasisName = "theorem"
    """theorem: for any input and hand; predicted: with friction, at the amplitude of a trial;
    measured: what the file `measured` says.
    """
    measured: str | None = None
    """A .zwidth file of this device; beside this file if relative."""
    margin_ns_per_m: float = Field(_guard.margin_ns_per_m, ge=0, le=100)
    """That has to be left for an environment to be allowed."""


class LeaseTable(TomlTable):
    """What a client that takes a lease has, unless it asks for something else."""

    ttl_s: float = Field(_lease.ttl_s, ge=SHORTEST_LEASE_S, le=LONGEST_LEASE_S)
    """A lease ends when its holder asked nothing for so long."""
    at_end: AtEnd = "zero"
    """When its holder dies or falls silent. zero: K, B and M, if they were leased, go to 0 on a
    ramp; disable: force off; hold: all stays. Active damping stays in any case.
    """


class Injection(TomlTable):
    """One seeded fault of the simulated board."""

    kind: str = Field(min_length=1)
    tick: int = Field(-1, ge=-1, le=LAST_TICK)
    """At this tick; -1: by probability."""
    probability: float = Field(0.0, ge=0, le=1)
    count: int = Field(1, ge=1, le=LAST_TICK)
    value: float = Field(0.0, ge=-1e9, le=1e9)


class Hand(TomlTable):
    """One touch of the simulated handle by a hand."""

    kind: Literal["hold", "push", "strike"]
    start_s: float = Field(_hand.start_s, ge=0)
    """After the first frame."""
    duration_s: float = Field(_hand.duration_s, gt=0)
    force_n: float = _hand.force_n
    """Of a push; highest of a strike."""
    stiffness_n_per_m: float = Field(_hand.stiffness_n_per_m, ge=0)
    """Of a hold."""
    damping_ns_per_m: float = Field(_hand.damping_ns_per_m, ge=0)
    """Of a hold."""
    tremor_m: float = Field(_hand.tremor_m, ge=0)
    """rms wander of the point at which it holds."""


class Touch(TomlTable):
    """What touches the moving part of the simulated device beside its motor; seeded by `seed`."""

    stop_stiffness_n_per_m: float = Field(_touch.stop_stiffness_n_per_m, ge=0)
    """0: inelastic stops."""
    stop_damping_ns_per_m: float = Field(_touch.stop_damping_ns_per_m, ge=0)
    coulomb_n: float = Field(_touch.coulomb_n, ge=0)
    """Added to the device's own friction at the rotor."""
    static_n: float = Field(_touch.static_n, ge=0)
    """That friction while the rotor stands; at least coulomb_n."""
    hands: tuple[Hand, ...] = Field((), strict=False)


class SimulatedBoard(TomlTable):
    """In what the simulated board is another one than its device file says.

    It says so in its hello and behaves accordingly; what is left out is as in the device file.
    """

    serial: str | None = Field(None, min_length=1, max_length=16, pattern=r"^[!-~]+$")
    """In the hello alone: it is still found by the device file's serial number."""
    lacks: tuple[Literal["probe", "temperature", "sample_phase", "resistance", "event"], ...] = (
        Field((), strict=False)
    )
    """Capabilities that it does not have."""
    position_m_per_count: float | None = Field(None, gt=0)
    force_full_scale_n: float | None = Field(None, gt=0)
    damping_full_scale_ns_per_m: float | None = Field(None, gt=0)
    probe_torque_full_scale_n: float | None = Field(None, gt=0)
    probe_velocity_full_scale_m_per_s: float | None = Field(None, gt=0)
    current_full_scale_a: float | None = Field(None, gt=0)
    voltage_full_scale_v: float | None = Field(None, gt=0)
    force_limit_n: float | None = Field(None, gt=0)
    """Beyond which it clamps the torque itself."""


class Bus(TomlTable):
    """A model of full-speed USB behind an xHCI controller; times that it gives are those of a
    model.
    """

    transfer: Literal["bulk", "interrupt"] = "bulk"
    bit_stuffing: float = Field(_bus.bit_stuffing, ge=0, le=1)
    """Share of the worst case."""
    nak_us: float = Field(_bus.nak_us, ge=1, le=1000)
    """After a NAK until the controller asks a bulk IN again."""
    hub_microframes: int = Field(_bus.hub_microframes, ge=0, le=2)
    """More each way behind a high-speed hub; 0: a root port."""
    moderation_us: float = Field(_bus.moderation_us, ge=0, le=10_000)
    """Shortest time between two interrupts of the controller."""
    frame_ppm: float = Field(_bus.frame_ppm, ge=-1000, le=1000)
    """By which the clock of the frames is slower than that of the host."""
    periodic_us: float = Field(_bus.periodic_us, ge=0, le=800)
    """Of each frame, taken by periodic transfers of other devices."""
    busy: float = Field(_bus.busy, ge=0, le=1)
    """Share of transfers that find a packet of another device on the wire."""
    submit_us: float = Field(_bus.submit_us, ge=0, le=1000)
    """Mean cost of a submission."""
    complete_us: float = Field(_bus.complete_us, ge=0, le=1000)
    """Mean time from the interrupt until the kernel has completed a transfer."""
    wake_us: float = Field(_bus.wake_us, ge=0, le=1000)
    """Mean time until a thread runs that waited for a transfer."""


class Simulation(TomlTable):
    """The simulated board's firmware; ignored with a real one."""

    sample_phase: float | None = Field(None, ge=0, lt=1)
    """When the encoder is latched, in periods after the board received a command.

    Left out: what the device's delay asks for.
    """
    effects: tuple[str, ...] | None = Field(None, strict=False)
    """Effects of the device that are built; left out: those that its file names."""
    watchdog_ms: float = Field(250.0, ge=1, le=10_000)
    seed: int = Field(1, ge=0)
    in_queue_depth: int = Field(_board["in_queue_depth"].default, ge=0, le=4)
    """IN packets that wait in the board until they are read; 0: the next one replaces it."""
    board_time_us: int = Field(_board["board_time_us"].default, ge=0, lt=2**32)
    """At which the board's time begins when it is powered up; it wraps at 2^32 us."""
    out_transport_us: float = Field(_board["out_transport_us"].default, ge=0, le=10_000)
    """How long a written packet is on its way to the board."""
    in_transport_us: float = Field(_board["in_transport_us"].default, ge=0, le=10_000)
    """How long a packet of the board is on its way to the host."""
    bus: Bus | None = None
    """In place of these two times: a model of the bus; left out: none."""
    emergency_stop_bounce_ms: float = Field(
        _board["emergency_stop_bounce_ms"].default, ge=0, le=100
    )
    """For how long the contact of the emergency stop bounces when it is pressed or released."""
    rights_s: float = Field(_board["rights_s"].default, ge=0, le=3600)
    """After it is plugged in until it may be opened, as while udev works."""
    hello_s: float = Field(_board["hello_s"].default, ge=0, le=3600)
    """After it is plugged in until it answers requests."""
    boot_loader_s: float = Field(_board["boot_loader_s"].default, ge=0, le=3600)
    """After it is plugged in during which it is its boot loader, which stalls requests."""
    board: SimulatedBoard = SimulatedBoard()
    injections: tuple[Injection, ...] = Field((), strict=False)
    touch: Touch | None = None
    """Stops that yield, a bearing that sticks, hands; left out: none of them."""


class Config(TomlTable):
    """hapticd.toml"""

    device: str = Field("simulated", min_length=1)
    """Name of a device file (devices/NAME.toml beside this file, else a shipped one), or a path."""
    active_damping_ns_per_m: float = Field(_active_damping_ns_per_m, ge=0)
    """Active damping that `hapticd damping on` asks for."""
    environment: EnvironmentTable = EnvironmentTable()
    safety: Safety = Safety()
    realtime: Realtime = Realtime()
    usb: Usb = Usb()
    gateway: GatewayTable = GatewayTable()
    guard: GuardTable = GuardTable()
    lease: LeaseTable = LeaseTable()
    simulation: Simulation = Simulation()
