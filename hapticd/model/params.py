"""Frozen parameters of a composed device, of the simulated board, and of the guard's worker.

`board.json` and `guard.json` are their plain JSON form (`core.params.from_plain`), so that these
processes read neither TOML nor scenes. The module needs the standard library alone, because the
simulated board imports it.
"""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from hapticd.core.environment import (
    Constraints,
    Environment,
    Microseconds,
    NotNegative,
    Positive,
    TableParams,
)
from hapticd.core.params import EnvironmentLimits, GuardParams

__all__ = [
    "BoardParams",
    "BoardTraits",
    "BusParams",
    "Contact",
    "DriveLimits",
    "Ends",
    "GuardSetup",
    "HandParams",
    "HeatingParams",
    "InjectionParams",
    "MeasuredLevel",
    "MeasuredParams",
    "ModelParams",
    "Noise",
    "OutputParams",
    "PlantParams",
    "RotorForce",
    "TouchParams",
]


LAST_TICK = 10**12  # of an injection: 30 years at 1 kHz


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
