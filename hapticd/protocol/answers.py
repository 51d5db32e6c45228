"""The replies of the daemon, as frozen dataclasses: the one schema of replies.

`schemas.json_schema` derives the JSON schema of replies from these classes, and the clients read
replies with `answer_of`. It leaves out fields that this release does not know, so a client works
with a newer daemon. A field with a default may be missing. Names of numbers contain their units.
`None` means unknown.

Every field that the gateway sends must be here (a test compares both).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, is_dataclass
from functools import lru_cache
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from hapticd.core.errors import CommandError
from hapticd.core.params import LEAST_IDLE_SHARE, ServoParams
from hapticd.protocol.journal import Entry

__all__ = [
    "Compensation",
    "Coupling",
    "Delivered",
    "Event",
    "Get",
    "GuardReading",
    "GuardStatus",
    "GuardVerdict",
    "Hand",
    "Hello",
    "InForce",
    "LateTicks",
    "LeaseHeld",
    "LeaseReleased",
    "Limit",
    "LimitCycleFault",
    "Receipt",
    "Room",
    "Status",
    "Timing",
    "TimingCost",
    "answer_of",
]

A = TypeVar("A")
# state of a fault that ends a limit cycle: on, or off because the device file has no value, during
# a measuring lease, or by request or configuration
LimitCycleFault = Literal["on", "no_overspeed", "no_physical_damping", "measuring", "off"]


def answer_of(kind: type[A], plain: Mapping[str, Any]) -> A:
    """Return the answer in the map `plain` of a reply, without fields that `kind` does not have.

    CommandError: a field without a default is missing.
    """
    hints = _hints(kind)
    known = {name: _made(hints[name], value) for name, value in plain.items() if name in hints}
    try:
        return kind(**known)
    except TypeError as error:  # a field without a default is not there
        text = f"{error}; the daemon has another version: restart it"
        raise CommandError("malformed", text) from error


_hints: Callable[[Any], dict[str, Any]] = lru_cache(maxsize=None)(get_type_hints)


def _made(hint: Any, value: Any) -> Any:
    """Return `value` of a message for a field of type `hint`; nested answers are converted too."""
    inside = [one for one in get_args(hint) if one is not NoneType]
    if value is None:
        return None
    if is_dataclass(hint):
        return answer_of(hint, value)  # type: ignore[arg-type]  # a class, not one of its objects
    if get_origin(hint) is UnionType:
        return _made(inside[0], value)
    if get_origin(hint) is tuple:
        return tuple(_made(inside[0], one) for one in value)
    if get_origin(hint) is dict and is_dataclass(inside[1]):
        return {name: _made(inside[1], one) for name, one in value.items()}
    return value


@dataclass(frozen=True, slots=True)
class GuardReading:
    """The distance of a display from the edge of stability; None where the basis gives
    no number.
    """

    margin_ns_per_m: float | None = None  #: damping margin, N s/m; negative: a shortfall
    worst_hz: float | None = None  #: frequency of the smallest margin
    radius: float | None = None  #: spectral radius of a tick; 1 or more: unstable by itself


@dataclass(frozen=True, slots=True)
class Hand:
    """A passive hand that destabilises the device, as a single mass or spring."""

    text: str = ""  #: the mass or spring, and its frequency
    mass_kg: float | None = None  #: one of these two
    stiffness_n_per_m: float | None = None  #: of a spring to the ground
    hz: float | None = None  #: frequency of the instability
    radius: float | None = None  #: spectral radius of a tick, with that hand
    growth: str = ""  #: growth of the motion, in words


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardVerdict(GuardReading):
    """The guard's verdict on a change, with the reading in free space."""

    safe: bool | None = None  #: passive for every hand, on the whole path; None: unknown
    policy: str = ""  #: of the judgement: off, warn, clamp, refuse, follow
    basis: str = "unknown"  #: theorem, predicted, or the measurement
    #: the reading in the wall; None without a wall
    contact: GuardReading | None = None
    delay_periods: float | None = None  #: assumed loop delay
    #: allowed range of each of K [N/m], B [N s/m] and M [kg], with the others as requested; None:
    #: no value is safe
    allowed: dict[str, list[float] | None] = field(default_factory=dict)
    least_active_damping_ns_per_m: float | None = None  #: lowest sufficient active damping
    clamped: bool = False  #: `given` is less than requested
    given: dict[str, Any] = field(default_factory=dict)  #: end of the change, shaped as a `set`
    path_points: int = 0  #: judged points of the path
    not_covered: tuple[str, ...] = ()  #: effects that no verdict covers
    outcome: str = ""  #: a `journal.Outcome`
    reasons: tuple[Entry, ...] = ()
    remedies: tuple[Entry, ...] = ()  #: alternatives: one is enough
    text: str = ""  #: one sentence made of these
    cmd: str = ""  #: the requested command: set, damping, enable ...
    number: int = 0  #: reference in the event with the hand
    stages: int = 0  #: number of stages
    hand: Hand | None = None  #: destabilising hand, if the client waited for it

    @property
    def worse(self) -> GuardReading:
        """The reading with the smaller margin: that in free space, or that in the wall."""
        free = GuardReading(self.margin_ns_per_m, self.worst_hz, self.radius)
        wall = self.contact
        if wall is None or wall.margin_ns_per_m is None or free.margin_ns_per_m is None:
            return free
        return wall if wall.margin_ns_per_m < free.margin_ns_per_m else free


@dataclass(frozen=True, slots=True)
class Receipt:
    """The servo's answer to an accepted change.

    Ticks count from the servo's start.
    """

    #: "applied": in force from `first_tick` on; "scheduled": in force later, with `effective` until
    #: then; "staged": started, and an event reports the end; "pressed": a stop by the stop word,
    #: without a receipt of the servo
    result: str = ""
    state: str = ""  #: of the servo: disabled, enabled, homing, stopped, fault, starting, down
    revision: int = 0  #: number of accepted changes in this life of the servo
    first_tick: int = 0  #: from which the change acts
    ramp_end_tick: int = 0  #: end of the last ramp
    effective: dict[str, Any] = field(default_factory=dict)  #: parameters in the shape of a `set`
    guard: GuardVerdict | None = None  #: on the change, if it was judged


@dataclass(frozen=True, slots=True)
class Limit:
    """The range of a field, both ends included."""

    low: float = 0.0  #: in `unit`
    high: float = 0.0  #: in `unit`
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Hello:
    """The identity of the daemon: versions, limits, endpoints."""

    rate_hz: float  #: of the servo
    simulated: bool
    servo: ServoParams  #: the configuration of the servo process
    actor: int = 0  #: number of this client
    limits: dict[str, Limit] = field(default_factory=dict)  #: by dotted field name
    server: str = "hapticd"
    version: str = ""
    protocol: int = 0
    schema_hash: str = ""
    layout: str = ""  #: hash of the mailbox's tables
    instance: str = ""
    endpoints: dict[str, Any] = field(default_factory=dict)
    topics: tuple[dict[str, Any], ...] = ()  #: name, rate and content of each


@dataclass(frozen=True, slots=True)
class InForce:
    """The values that act at a tick, during ramps too."""

    tick: int = -1
    gain: float = 0.0
    stiffness_n_per_m: float = 0.0
    virtual_damping_ns_per_m: float = 0.0
    mass_kg: float = 0.0
    active_damping_asked_ns_per_m: float = 0.0
    active_damping_ns_per_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Get:
    """The parameters."""

    #: at the ends of their ramps, in the shape of a `set`; units as in `Hello.limits`
    parameters: dict[str, Any] = field(default_factory=dict)
    in_force: InForce = InForce()


@dataclass(frozen=True, slots=True)
class Coupling:
    """Handle and proxy at one tick, for the law of a proxy."""

    tick: int = 0
    time_s: float = 0.0  #: since the servo started, lost periods included
    position_m: float = 0.0  #: of the handle
    velocity_m_per_s: float = 0.0  #: of the handle, filtered; 0 unless `fresh`
    proxy_m: float = 0.0  #: position of the proxy
    #: of the spring on the proxy, before the force limit; the opposite acts on the handle
    force_n: float = 0.0
    stiffness_n_per_m: float = 0.0  #: of the spring, gain included
    #: whether the proxy stays: its law is late, has no lease or has used its energy
    held: bool = False
    fresh: bool = True  #: whether a sample arrived in this tick; else the position is the last one


@dataclass(frozen=True, slots=True)
class LeaseHeld:
    """A held lease."""

    name: str = ""  #: of its holder
    actor: int = 0
    left_s: float = 0.0  #: until it ends, if its holder sends no request
    ttl_s: float = 0.0
    at_end: str = ""  #: zero, disable or hold


@dataclass(frozen=True, slots=True)
class LeaseReleased:
    """A released lease."""

    what: str = ""
    released: bool = False  #: whether it was held until then
    code: str = ""  #: how it ended: a `journal.EventCode`
    text: str = ""  #: the same in words


@dataclass(frozen=True, slots=True)
class Delays:
    """The delay from a sample to its force, in periods of the servo."""

    counted_periods: float | None = None  #: on which the guard counts
    measured: bool = False  #: whether that one is; else the model's
    measured_p99_periods: float | None = None
    model_periods: float | None = None


@dataclass(frozen=True, slots=True)
class TimingCost:
    """The stiffness that the delay costs at a level of active damping, by the theorem."""

    level_ns_per_m: float = 0.0  #: of active damping
    stiffness_n_per_m: float = 0.0  #: the largest passive one
    ideal_stiffness_n_per_m: float = 0.0  #: the same without the delay
    lost_share: float | None = None


@dataclass(frozen=True, slots=True)
class Timing:
    """The cost of the delay."""

    delay_periods: float = 0.0
    ideal_delay_periods: float = 0.0
    without_active_damping: TimingCost = TimingCost()
    with_active_damping: TimingCost = TimingCost()
    measured: bool = False  #: whether the delay was measured; otherwise that of the model


@dataclass(frozen=True, slots=True)
class GuardStatus:
    """The terms of the guard, and its verdict on the environment in force."""

    policy: str = ""  #: off, warn, clamp, refuse, follow
    basis: str = ""  #: theorem, predicted, measured
    margin_ns_per_m: float = 0.0  #: required margin
    mode: str = ""  #: of the active damping: off, level, auto
    worker: str = ""  #: state of the worker: up, starting, down, none
    delay_periods: float | None = None
    measuring: bool = False  #: whether the measuring lease is held, so that nothing is judged
    trouble: str = ""  #: of the worker
    pid: int | None = None  #: of the worker
    model: bool | None = None  #: whether the device has one
    model_hash: str | None = None
    delays: Delays | None = None
    timing: Timing | None = None
    verdict: GuardVerdict | None = None
    unjudged: str = ""  #: why there is no verdict
    waiting: int = 0  #: requests not yet judged
    under_way: dict[str, Any] | None = None  #: the change with remaining stages


@dataclass(frozen=True, slots=True)
class Compensation:
    """The compensation of the winding's resistance; None: unknown without a sensor."""

    compensated_ohm: float = 0.0
    tolerance_ohm: float = 0.0
    least_loop_gain: float = 0.0
    winding_c: float | None = None
    winding_ohm: float | None = None
    residual_ohm: float | None = None  #: above 0: compensation too low; below 0: too high
    loop_gain: float | None = None  #: at the level in effect; the circuit oscillates at -1
    loop_gain_at_ceiling: float | None = None  #: at the highest level of the device


@dataclass(frozen=True, slots=True)
class Delivered:
    """The active damping that the board delivers."""

    basis: str = "unknown"  #: basis of the estimate, or why there is none
    commanded: float = 0.0  #: N s/m
    estimate_ns_per_m: float | None = None
    low: float | None = None  #: ends of the 95 % interval, N s/m
    high: float | None = None
    ratio: float | None = None  #: of the estimate to the commanded damping
    seconds: float = 0.0  #: duration of the records used


@dataclass(frozen=True, slots=True)
class StageTimes:
    """The duration of a stage of the tick."""

    count: int = 0
    p50_us: float = 0.0
    p99_us: float = 0.0
    p999_us: float = 0.0
    max_us: float = 0.0


@dataclass(frozen=True, slots=True)
class LateTicks:
    """Ticks that were late for one cause."""

    count: int = 0
    latest_us: float = 0.0  #: largest delay of an end after its deadline


@dataclass(frozen=True, slots=True)
class Room:
    """The share of the period that a tick takes, from the stages measured since the servo started.

    A tick that takes nearly the whole period is late at any disturbance.
    """

    tick_us: float = 0.0  #: 0: not yet known
    period_us: float = 0.0
    highest_rate_hz: float = 0.0  #: that leaves a quarter of the period; 0: not yet known

    @property
    def short(self) -> bool:
        """Whether less than a quarter of the period is left."""
        return self.tick_us > (1.0 - LEAST_IDLE_SHARE) * self.period_us


@dataclass(frozen=True, slots=True, kw_only=True)
class Event(Receipt):
    """An event, with the receipt of a change. Fields that an event of its `kind` does not contain
    have their default.
    """

    kind: str = ""  #: see `journal`; a newer daemon may have others
    code: str = ""  #: which event of that kind: a `journal.EventCode`
    timestamp: float = 0.0  #: Unix time, s
    tick: int = -1
    actor: int = 0  #: number of the client that caused it
    name: str = ""  #: of that client
    before: str = ""  #: state of the servo until then
    fault: str = ""
    cause: str = ""  #: of the fault
    action: str = ""  #: taken by the servo
    remedy: str = ""
    cmd: str = ""  #: of the answered request, or of the one that a hand destabilises
    id: int | str | None = None  #: of that request
    number: int = 0  #: of the verdict to which the hand belongs
    hand: Hand | None = None  #: None: none was found
    seq: int = 0  #: of the record after a gap
    lost: int = 0  #: records in the gap
    epoch: int = 0  #: monotonic time at which the servo started, ns
    path: str = ""  #: of a flight recording, or of a file of keys
    reason: str = ""  #: why it was written, or why something failed
    error: str = ""  #: code of a refusal
    what: str = ""  #: that is leased
    by: str = ""  #: who took the lease over
    ttl_s: float = 0.0  #: of the lease
    position_m: float | None = None  #: of the proxy
    by_cmd: str = ""  #: of the request because of which the rest of a change is not done
    by_actor: int = 0  #: who asked it
    reported_ns_per_m: float | None = None  #: active damping that the board reports
    needed_ns_per_m: float | None = None  #: that the next stage waited for
    excess_j: float | None = None  #: energy that leaked
    tick_us: float = 0.0  #: that a tick takes of its period, where that is too much
    period_us: float = 0.0
    highest_rate_hz: float = 0.0  #: that would leave enough
    percent: float = 0.0  #: of the period, or of the active damping that is commanded
    delivered: Delivered | None = None  #: of the active damping, where it is too little
    asked: dict[str, Any] = field(default_factory=dict)  #: of the guard, before the gateway started
    configured: dict[str, Any] = field(default_factory=dict)  #: for the guard
    terms: dict[str, Any] = field(default_factory=dict)  #: by which the guard judges from now on
    address: str = ""  #: of a listener that was refused, or at which telemetry is offered
    port: int = 0  #: that is taken
    times: int = 1  #: how often
    text: str = ""  #: one sentence made of these


@dataclass(frozen=True, slots=True, kw_only=True)
class Status(InForce):
    """The state of servo and gateway. Values of a record are 0, or -1 for a tick and a delay, while
    no servo is alive.
    """

    state: str = ""  #: disabled, enabled, homing, stopped, fault, starting, down
    timestamp: float = 0.0  #: Unix time, s
    servo_alive: bool = False
    simulated: bool | None = None
    rate_hz: float = 0.0
    revision: int = 0
    fault: str = "none"
    cause: str = ""  #: of the fault
    action: str = ""  #: taken by the servo
    remedy: str = ""
    waiting_for: str = ""  #: why the servo has no board
    instance: str = ""
    epoch: int = 0  #: monotonic time of the servo's start, ns
    config_hash: str = ""
    slot: int = -1
    homed: int = 0
    perturbing: int = 0
    position_m: float = 0.0
    proxy_m: float = 0.0
    proxy_held: bool = False  #: as `held` of `Coupling`
    force_n: float = 0.0
    #: delay from sample to force, and age of a frame when it was read, us: 99th percentile of the
    #: last 256 ticks with a frame
    delay_us: int = -1
    frame_age_us: int = -1
    delay_spread_us: int = -1  #: maximum minus minimum delay of the last 256 ticks
    winding_c: float | None = None
    actor: int = 0  #: client of the last change
    actor_name: str = ""
    actors: dict[Any, str] = field(default_factory=dict)  #: names by number
    limit_cycle_faults: dict[str, LimitCycleFault] = field(default_factory=dict)  #: by their names
    commissioning: dict[str, Any] | None = None  #: what holds until the signs are verified
    compensation: Compensation | None = None
    leases: dict[str, LeaseHeld] = field(default_factory=dict)
    counters: dict[str, int] = field(default_factory=dict)
    delivered_active_damping: Delivered | None = None
    stages: dict[str, StageTimes] = field(default_factory=dict)
    #: by cause (`mailbox.layout.LateCause`)
    late: dict[str, LateTicks] = field(default_factory=dict)
    #: share of the period that a tick takes
    room: Room | None = None
    endpoints: dict[str, Any] = field(default_factory=dict)
    #: of the servo process: granted rights, board and bus
    servo: dict[str, Any] = field(default_factory=dict)
    gateway: dict[str, Any] = field(default_factory=dict)  #: its process and its relay
    guard: GuardStatus | None = None
    events: tuple[Event, ...] = ()  #: the last ones of the topic `event`
    requests: dict[str, int] = field(default_factory=dict)  #: counts of requests
