"""The parameters of every process, as frozen values in SI units, and their JSON form.

`settings` validates TOML with pydantic and builds these; servo.json, board.json and gateway.json
are their plain form, so that a process needs neither TOML nor pydantic. `from_plain` rebuilds a
tree and refuses unknown or missing keys. A default is written here and nowhere else.

What would break it: a field whose type `from_plain` does not know (it knows numbers, text, truth
values, tuples of one type, None, and dataclasses of these).
"""

import dataclasses
import types
import typing
from dataclasses import dataclass, field
from typing import Any, TypeVar

from hapticd.errors import ConfigError
from hapticd.units import round_half_up

T = TypeVar("T")

ADDED_DAMPING_NS_PER_M = 1.74  # of `damping on`: Weir, Colgate and Peshkin 2008, section 5


@dataclass(frozen=True, slots=True)
class FilterParams:
    """A second-order low-pass."""

    frequency_hz: float  # corner
    damping_ratio: float = 0.7071067811865476  # 0.7071 is Butterworth
    mapping: str = "prewarped"  # prewarped | bilinear | matched: how it is made discrete


@dataclass(frozen=True, slots=True)
class WallParams:
    """A unilateral wall: it pushes towards its free side only."""

    stiffness_n_per_m: float = 0.0  # of the wall
    damping_ns_per_m: float = 0.0  # acts inside the wall alone
    position_m: float = 0.0  # of its surface
    side: int = 0  # +1: solid for x > position; -1: for x < position; 0: no wall


@dataclass(frozen=True, slots=True)
class WorkspaceParams:
    """Soft ends: springs that start at the ends of the usable travel."""

    lower_m: float = -1.0  # where the lower spring begins
    upper_m: float = 1.0  # where the upper spring begins
    stiffness_n_per_m: float = 0.0  # of both; 0: no springs


@dataclass(frozen=True, slots=True)
class EnvironmentParams:
    """The virtual environment: K on raw position, B and M on filtered derivatives.

    Source: Weir, Colgate and Peshkin 2008, section 2.
    """

    stiffness_n_per_m: float = 0.0  # K
    damping_ns_per_m: float = 0.0  # B
    mass_kg: float = 0.0  # M
    velocity_filter: FilterParams = FilterParams(100.0)  # before B, 100 Hz in the paper
    acceleration_filter: FilterParams = FilterParams(72.0)  # before M, 72 Hz in the paper
    wall: WallParams = WallParams()
    workspace: WorkspaceParams = WorkspaceParams()


@dataclass(frozen=True, slots=True)
class ScaleParams:
    """value = sign * (count - offset_count) * per_count."""

    per_count: float  # SI unit of the quantity per count
    sign: int = 1  # +1 or -1
    offset_count: float = 0.0  # count that means zero
    date: str = ""  # when it was measured
    source: str = ""  # calibration record, data sheet, paper, or "assumed"

    def to_value(self, count: float) -> float:
        """SI value of `count`."""
        return self.sign * (count - self.offset_count) * self.per_count

    def to_count(self, value: float, low: int, high: int) -> int:
        """Nearest count for a finite SI `value`, held inside `low`..`high`."""
        count = round_half_up(self.sign * value / self.per_count + self.offset_count)
        return max(low, min(high, count))


@dataclass(frozen=True, slots=True)
class HomeParams:
    """How the origin of position is found: against a stop at bounded force, or at the index."""

    method: str = "none"  # none | stop | index
    required: bool = False  # refuse to enable before it was done
    direction: int = -1  # +1 or -1 along x
    speed_m_per_s: float = 0.01  # while looking for it
    force_n: float = 0.5  # largest force while looking for it
    position_m: float = 0.0  # where the stop or index lies
    timeout_s: float = 10.0  # then the fault home_failed


@dataclass(frozen=True, slots=True)
class DeviceParams:
    """A device file: what one count means on this device, and its limits."""

    name: str
    serial: str
    position: ScaleParams  # m
    force: ScaleParams  # N
    damping: ScaleParams  # N s/m of active damping
    probe_torque: ScaleParams  # N at the endpoint
    probe_velocity: ScaleParams  # m/s
    current: ScaleParams  # A
    voltage: ScaleParams  # V
    emf_velocity: ScaleParams  # m/s
    temperature: ScaleParams  # degC
    force_limit_n: float  # largest magnitude
    damping_limit_ns_per_m: float  # highest active damping
    probe_limit_n: float  # largest magnitude of a perturbation
    temperature_limit_c: float  # of the winding, then the fault over_temperature
    speed_limit_m_per_s: float  # faster is not a motion but a sensor fault
    home: HomeParams = HomeParams()


@dataclass(frozen=True, slots=True)
class SafetyParams:
    """Times and levels of the safety table."""

    force_limit_n: float = 8.0  # largest magnitude of the force that is sent
    enable_ramp_s: float = 0.5  # of the gain from 0 to 1
    stop_ramp_s: float = 0.02  # of the force to 0
    damping_hold_s: float = 2.0  # of the safe damping after a stop or fault
    damping_release_s: float = 0.5  # from there to 0
    safe_damping_ns_per_m: float = 0.0  # least active damping after a stop or fault
    damping_slew_ns_per_m_s: float = 20.0  # fastest change of active damping
    gateway_timeout_s: float = 1.0  # heartbeat older than this: gateway_lost
    on_gateway_loss: str = "fault"  # "fault" | "hold"
    lost_slots_limit: int = 10  # within one second
    missing_frames_limit: int = 8  # one after the other
    default_ramp_s: float = 0.05  # of a `set` that names none


@dataclass(frozen=True, slots=True)
class RealtimeParams:
    """What the servo process asks of the operating system."""

    rate_hz: float = 1000.0  # of the servo
    # "strict": refuse to start without the rights | "best_effort": report what was granted | "off"
    mode: str = "best_effort"
    priority: int = 79  # SCHED_FIFO
    core: int | None = None  # None: the last one of those allowed
    spin_us: float = 100.0  # busy waiting before each deadline
    lock_memory: bool = True
    grace_s: float = 1.0  # start-up overruns are counted apart for this long


@dataclass(frozen=True, slots=True)
class UsbParams:
    """Which board: None matches any."""

    vendor_id: int = 0x1209  # pid.codes
    product_id: int = 0x0001
    serial: str | None = None  # None: any
    timeout_ms: int = 2  # of one transfer


@dataclass(frozen=True, slots=True)
class ServoParams:
    """Everything the servo process needs (servo.json)."""

    instance: str
    simulated: bool  # a simulated board, which board.json describes
    environment: EnvironmentParams
    device: DeviceParams
    safety: SafetyParams
    realtime: RealtimeParams
    usb: UsbParams
    added_damping_ns_per_m: float = ADDED_DAMPING_NS_PER_M  # what `damping on` asks for
    config_hash: str = ""  # SHA-256 of the configuration, hex


@dataclass(frozen=True, slots=True)
class InjectionParams:
    """One seeded fault of the simulated board."""

    kind: str  # a name of sim.injection
    tick: int = -1  # -1: by probability
    probability: float = 0.0  # at each tick
    count: int = 1  # how many times in a row
    value: float = 0.0  # what it means depends on the kind


@dataclass(frozen=True, slots=True)
class Contact:
    """Set-valued Coulomb friction on one body: a force f in [-level_n, level_n].

    Sliding: f = -level_n sign(v). Sticking: v = 0 exactly.
    """

    body: str  # rotor | slider
    velocity: int  # index of the state
    position: int  # index of the state
    level_n: float  # Fc
    column: int  # of B, on which the friction force acts


@dataclass(frozen=True, slots=True)
class Ends:
    """Inelastic ends of the workspace, which hold one body."""

    lower_m: float  # lowest position
    upper_m: float  # highest position
    position: int  # index of the state
    velocity: int  # index of the state


@dataclass(frozen=True, slots=True)
class RotorForce:
    """A force F(x, v) on the rotor that is not linear, on the input `rotor_force`."""

    law: str  # its name in `plant.composed` and `sim.engine.rotor_laws`
    numbers: tuple[float, ...]  # parameters of the law, SI units
    position: int  # index of the rotor's state
    velocity: int  # index of the rotor's state


@dataclass(frozen=True, slots=True)
class Noise:
    """White noise of two channels. A value of density S held for h has the variance S / (2 h)."""

    velocity_m_per_s: float = 0.0  # rms, added to each 4 kHz value of the recorded velocity
    estimate_psd: float = 0.0  # one-sided density of the velocity estimate, (m/s)^2/Hz


@dataclass(frozen=True, slots=True)
class OutputParams:
    """y = (c0 + b c1) x + (d0 + b d1) u, over n states and m inputs; b is the damping level."""

    c0: tuple[float, ...]  # (n,), in the unit of y over that of the state
    c1: tuple[float, ...]  # (n,), per N s/m of damping level
    d0: tuple[float, ...]  # (m,)
    d1: tuple[float, ...]  # (m,), per N s/m


@dataclass(frozen=True, slots=True)
class HeatingParams:
    """The winding's own state, its temperature T.

    dT/dt = (R(T) (F/K)^2 R_th - (T - ambient)) / tau,  dR = R(T) - compensated_ohm
    """

    resistance_ohm: float  # at reference_c
    reference_c: float  # temperature of resistance_ohm
    compensated_ohm: float  # resistance that the damping circuit believes in
    thermal_resistance_k_per_w: float  # winding to surroundings
    time_constant_s: float  # of the winding against its surroundings
    ambient_c: float  # of the surroundings
    start_c: float  # of the winding


@dataclass(frozen=True, slots=True)
class PlantParams:
    """The composed device of a simulated board: its exact maps, and what is not linear.

    A map covers one sub-step. It is the n rows of [Phi Gamma], n + m numbers each, one after the
    other, for n states and m inputs. Between the nodes of the table it is interpolated.
    """

    states: tuple[str, ...]  # n names
    # m names: command, torque, then estimate, rotor_force and one per contact, if there are any
    columns: tuple[str, ...]
    floating: bool  # nothing holds the device in place: only differences of positions matter
    levels_ns_per_m: tuple[float, ...]  # rising, from 0
    residuals_ohm: tuple[float, ...]  # rising; one, if the winding's temperature does not change
    maps: tuple[tuple[float, ...], ...]  # one for each residual and, in it, each level
    encoder: OutputParams  # m
    travel: OutputParams  # its differences over the 4 kHz interval are the recorded velocity
    impulse: OutputParams | None  # its differences are added to the recorded torque
    motor_force: OutputParams  # N
    estimate: OutputParams  # m/s
    contacts: tuple[Contact, ...] = ()
    ends: Ends | None = None
    rotor_forces: tuple[RotorForce, ...] = ()
    noise: Noise | None = None
    estimate_offset_m_per_s: float = 0.0  # constant on the column `estimate`
    heating: HeatingParams | None = None


@dataclass(frozen=True, slots=True)
class BoardParams:
    """Everything the simulated board needs (board.json): firmware scales and plant numbers."""

    serial: str
    rate_hz: float  # of the servo
    position_m_per_count: float
    force_n_per_count: float
    damping_ns_per_m_per_count: float
    probe_torque_n_per_count: float
    probe_velocity_m_per_s_per_count: float
    current_a_per_count: float
    voltage_v_per_count: float
    force_limit_n: float  # of the firmware
    mass_kg: float  # device and probe
    viscous_ns_per_m: float  # of the rigid mass
    lower_stop_m: float  # of the rigid mass
    upper_stop_m: float  # of the rigid mass
    torque_constant_n_per_a: float  # K_m / lever radius
    winding_ohm: float
    ambient_c: float  # of the winding at the start
    sample_phase: float = 0.875  # of a period: when the encoder is latched after an OUT
    watchdog_ms: float = 250.0  # without an OUT for so long the board stops
    seed: int = 1  # of its noise and its injected faults
    injections: tuple[InjectionParams, ...] = field(default_factory=tuple)
    emf_velocity_m_per_s_per_count: float = 2.0 / 32767
    temperature_c_per_count: float = 0.01
    # whole periods of transport delay between the receipt of a torque and its effect
    lag_periods: int = 0
    plant: PlantParams | None = None  # the composed device; without it one rigid mass


@dataclass(frozen=True, slots=True)
class GatewayParams:
    """What the gateway process needs for itself."""

    telemetry_port: int = 9872  # PlotJuggler's default; an ephemeral one when taken
    batch: int = 20  # ticks in one `servo` message
    tcp_host: str = "127.0.0.1"
    allow_insecure: bool = False  # another host than the loopback without CURVE keys
    curve_keys: str | None = None  # folder of server key and allowed client keys
    flight_s: float = 60.0  # kept by the flight recorder


@dataclass(frozen=True, slots=True)
class GatewaySetup:
    """gateway.json: the gateway's own parameters, and the servo's for its limits and scales."""

    servo: ServoParams
    gateway: GatewayParams = GatewayParams()


def to_plain(value: Any) -> Any:
    """A tree of dataclasses as dicts and lists, which json writes."""
    return dataclasses.asdict(value)


def from_plain(kind: type[T], plain: Any, where: str = "") -> T:
    """Dicts and lists as a tree of dataclasses of type `kind`.

    ConfigError with the path of the wrong key; `where` begins that path.
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
