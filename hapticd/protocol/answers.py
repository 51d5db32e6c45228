"""What the daemon answers, as frozen dataclasses: the one schema of its replies.

`schemas.json_schema` derives the JSON schema of replies from these classes, and the clients read
replies with `answer_of`. It leaves out fields that this release does not know, so a client works
with a newer daemon. A field with a default may be missing. Units are in the names of numbers.
`None` stands for what is not known.

Every field that the gateway sends must be here (a test compares both).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, is_dataclass
from functools import lru_cache
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from hapticd.core.errors import CommandError
from hapticd.core.params import ServoParams
from hapticd.protocol.explanation import Entry

__all__ = [
    "LEAST_IDLE_SHARE",
    "Compensation",
    "Delays",
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
    "StageTimes",
    "Status",
    "Timing",
    "TimingCost",
    "answer_of",
    "verdict_of",
]

A = TypeVar("A")
# whether a fault that ends a limit cycle is on, or why it is off: the device file gives no value,
# measuring is leased, or it was asked or configured so
LimitCycleFault = Literal["on", "no_overspeed", "no_physical_damping", "measuring", "off"]


def answer_of(kind: type[A], plain: Mapping[str, Any]) -> A:
    """The answer in the map `plain` of a reply, without fields that `kind` does not have.

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
    """`value` of a message, as a field of type `hint` holds it: answers inside are made, too."""
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
    """How far a display is from the edge; None where the basis does not say."""

    margin_ns_per_m: float | None = None  #: damping to spare, N s/m; negative: so much is lacking
    worst_hz: float | None = None  #: the frequency at which it is least
    radius: float | None = None  #: spectral radius of a tick; 1 or more: unstable by itself


@dataclass(frozen=True, slots=True)
class Hand:
    """A hand that would shake the device, as one thing that can be imagined."""

    text: str = ""  #: which mass or spring, at which frequency
    mass_kg: float | None = None  #: one of these two
    stiffness_n_per_m: float | None = None  #: of a spring to the ground
    hz: float | None = None  #: at which it shakes
    radius: float | None = None  #: spectral radius of a tick, with that hand
    growth: str = ""  #: how fast its motion grows, in words


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardVerdict(GuardReading):
    """What the guard says of a change, with the reading in free space."""

    safe: bool | None = None  #: of what was asked, every hand and the whole way; None: unknown
    policy: str = ""  #: by which it was judged: off, warn, clamp, refuse, follow
    basis: str = "unknown"  #: theorem, predicted, or the measurement
    #: the reading in the wall; None without a wall
    contact: GuardReading | None = None
    delay_periods: float | None = None  #: of the loop, on which it counts
    #: ends of each of K [N/m], B [N s/m] and M [kg], with the others as asked; None: nothing would
    #: do
    allowed: dict[str, list[float] | None] = field(default_factory=dict)
    least_active_damping_ns_per_m: float | None = None  #: of active damping that would do
    clamped: bool = False  #: `given` is less than what was asked
    given: dict[str, Any] = field(default_factory=dict)  #: where it leads, in the shape of a `set`
    path_points: int = 0  #: that were judged on the way
    not_covered: tuple[str, ...] = ()  #: what no verdict promises
    outcome: str = ""  #: an `explanation.Outcome`
    reasons: tuple[Entry, ...] = ()  #: what is wrong, or known
    remedies: tuple[Entry, ...] = ()  #: of which one would do
    text: str = ""  #: one sentence made of these
    cmd: str = ""  #: what was asked: set, damping, enable ...
    number: int = 0  #: by which the event with the hand refers to it
    stages: int = 0  #: in which it is done
    hand: Hand | None = None  #: that would shake it, where it was waited for

    @property
    def worse(self) -> GuardReading:
        """The reading with less to spare: that in free space, or that in the wall."""
        free = GuardReading(self.margin_ns_per_m, self.worst_hz, self.radius)
        wall = self.contact
        if wall is None or wall.margin_ns_per_m is None or free.margin_ns_per_m is None:
            return free
        return wall if wall.margin_ns_per_m < free.margin_ns_per_m else free


def verdict_of(plain: Mapping[str, Any] | None) -> GuardVerdict | None:
    """The verdict in the map `plain` of a reply or an event; None where there is none."""
    return answer_of(GuardVerdict, plain) if plain else None


@dataclass(frozen=True, slots=True)
class Receipt:
    """What became of an accepted change, as the servo answered.

    Ticks count from the servo's start.
    """

    #: "applied": in force from `first_tick` on; "scheduled": will be, and `effective` holds until
    #: then; "staged": it has begun, and an event tells the end; "pressed": a stop by way of the
    #: stop word, which gives no receipt
    result: str = ""
    state: str = ""  #: of the servo: disabled, enabled, homing, stopped, fault, starting, down
    revision: int = 0  #: number of accepted changes in this life of the servo
    first_tick: int = 0  #: from which the change acts
    ramp_end_tick: int = 0  #: at which the last ramp ends
    effective: dict[str, Any] = field(default_factory=dict)  #: parameters in the shape of a `set`
    guard: GuardVerdict | None = None  #: on it, if one was asked for


@dataclass(frozen=True, slots=True)
class Limit:
    """What may be asked for a field, both ends included."""

    low: float = 0.0  #: in `unit`
    high: float = 0.0  #: in `unit`
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Hello:
    """Who answers: versions, limits, endpoints."""

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
    """What acts at a tick, on the way of every ramp."""

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

    #: as asked, ramps at their ends, in the shape of a `set`; units as in `Hello.limits`
    parameters: dict[str, Any] = field(default_factory=dict)
    in_force: InForce = InForce()


@dataclass(frozen=True, slots=True)
class LeaseHeld:
    """A lease that is held."""

    name: str = ""  #: of its holder
    actor: int = 0
    left_s: float = 0.0  #: until it ends, if its holder asks for nothing
    ttl_s: float = 0.0
    at_end: str = ""  #: zero, disable or hold


@dataclass(frozen=True, slots=True)
class LeaseReleased:
    """A lease that was given up."""

    what: str = ""
    released: bool = False  #: whether it was held until then
    code: str = ""  #: how it ended: a `journal.EventCode`
    text: str = ""  #: the same in words


@dataclass(frozen=True, slots=True)
class Delays:
    """From a sample to the force that it makes, in periods of the servo."""

    counted_periods: float | None = None  #: on which the guard counts
    measured: bool = False  #: whether that one is; else the model's
    measured_p99_periods: float | None = None
    model_periods: float | None = None


@dataclass(frozen=True, slots=True)
class TimingCost:
    """What the delay costs of K at a level of active damping, by the theorem."""

    level_ns_per_m: float = 0.0  #: of active damping
    stiffness_n_per_m: float = 0.0  #: the largest that is passive
    ideal_stiffness_n_per_m: float = 0.0  #: the same without the delay
    lost_share: float | None = None


@dataclass(frozen=True, slots=True)
class Timing:
    """What the delay costs."""

    delay_periods: float = 0.0
    ideal_delay_periods: float = 0.0
    without_active_damping: TimingCost = TimingCost()
    with_active_damping: TimingCost = TimingCost()
    measured: bool = False  #: whether the delay is; else the model's


@dataclass(frozen=True, slots=True)
class GuardStatus:
    """What the guard goes by, and its verdict on what is in force."""

    policy: str = ""  #: off, warn, clamp, refuse, follow
    basis: str = ""  #: theorem, predicted, measured
    margin_ns_per_m: float = 0.0  #: that has to be left
    mode: str = ""  #: of the active damping: off, level, auto
    worker: str = ""  #: "up", or why not
    delay_periods: float | None = None
    measuring: bool = False  #: whether somebody measures, so that nothing is judged
    trouble: str = ""  #: of the worker
    pid: int | None = None  #: of the worker
    model: bool | None = None  #: whether the device has one
    model_hash: str | None = None
    delays: Delays | None = None
    timing: Timing | None = None
    verdict: GuardVerdict | None = None
    unjudged: str = ""  #: why there is no verdict
    waiting: int = 0  #: requests that are not judged yet
    under_way: dict[str, Any] | None = None  #: the change of which stages are still to come


@dataclass(frozen=True, slots=True)
class Compensation:
    """What is compensated of the winding's resistance; None: not known without a sensor."""

    compensated_ohm: float = 0.0
    tolerance_ohm: float = 0.0
    least_loop_gain: float = 0.0
    winding_c: float | None = None
    winding_ohm: float | None = None
    residual_ohm: float | None = None  #: above 0 too little is compensated, below 0 too much
    loop_gain: float | None = None  #: at the level in effect; the circuit oscillates at -1
    loop_gain_at_ceiling: float | None = None  #: at the highest level of the device


@dataclass(frozen=True, slots=True)
class Delivered:
    """How much active damping the board delivers."""

    basis: str = "unknown"  #: what the estimate rests on, or why there is none
    commanded: float = 0.0  #: N s/m
    estimate_ns_per_m: float | None = None
    low: float | None = None  #: ends of the 95 % interval, N s/m
    high: float | None = None
    ratio: float | None = None  #: of the estimate to what is commanded
    seconds: float = 0.0  #: of the records that it rests on


@dataclass(frozen=True, slots=True)
class StageTimes:
    """How long a part of the tick takes."""

    count: int = 0
    p50_us: float = 0.0
    p99_us: float = 0.0
    p999_us: float = 0.0
    max_us: float = 0.0


@dataclass(frozen=True, slots=True)
class LateTicks:
    """Ticks that were late by one cause."""

    count: int = 0
    latest_us: float = 0.0  #: after its deadline the latest of them ended


LEAST_IDLE_SHARE = 0.25  # of a period, that a tick has to leave


@dataclass(frozen=True, slots=True)
class Room:
    """What a tick takes of its period, by the stages that were measured since the servo started.

    A tick that takes nearly all of it is late whenever anything holds it up.
    """

    tick_us: float = 0.0  #: 0: not known yet
    period_us: float = 0.0
    highest_rate_hz: float = 0.0  #: at which a quarter of the period is left; 0: not known yet

    @property
    def short(self) -> bool:
        """Whether less than a quarter of the period is left."""
        return self.tick_us > (1.0 - LEAST_IDLE_SHARE) * self.period_us


@dataclass(frozen=True, slots=True, kw_only=True)
class Event(Receipt):
    """Something that happened, with the receipt of a change. What an event of its `kind` does not
    tell has its default.
    """

    kind: str = ""  #: see `journal`; a newer daemon may have others
    code: str = ""  #: which event of that kind: a `journal.EventCode`
    timestamp: float = 0.0  #: Unix time, s
    tick: int = -1
    actor: int = 0  #: whose doing it was
    name: str = ""  #: of that client
    before: str = ""  #: state of the servo until then
    fault: str = ""
    cause: str = ""  #: of the fault
    action: str = ""  #: that was taken
    remedy: str = ""
    cmd: str = ""  #: of the request that is answered, or that a hand would shake
    id: int | str | None = None  #: of that request
    number: int = 0  #: of the verdict that the hand belongs to
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
    mode: str = ""  #: of the active damping, if the guard chooses it
    address: str = ""  #: of a listener that was refused, or at which telemetry is offered
    port: int = 0  #: that is taken
    times: int = 1  #: how often
    text: str = ""  #: one sentence made of these


@dataclass(frozen=True, slots=True, kw_only=True)
class Status(InForce):
    """Everything about servo and gateway. What a record tells is 0, or -1 for a tick and a delay,
    while no servo is alive.
    """

    state: str = ""  #: disabled, enabled, homing, stopped, fault, starting, down
    timestamp: float = 0.0  #: Unix time, s
    servo_alive: bool = False
    simulated: bool | None = None
    rate_hz: float = 0.0
    revision: int = 0
    fault: str = "none"
    cause: str = ""  #: of the fault
    action: str = ""  #: that was taken
    remedy: str = ""
    waiting_for: str = ""  #: why the servo has no board
    instance: str = ""
    epoch: int = 0  #: monotonic time at which the servo started, ns
    config_hash: str = ""
    slot: int = -1
    homed: int = 0
    perturbing: int = 0
    position_m: float = 0.0
    force_n: float = 0.0
    #: from sample to force, and age of a frame when it was read, us: 99 of 100 of the last 256
    #: ticks that had a frame did not exceed them
    delay_us: int = -1
    frame_age_us: int = -1
    delay_spread_us: int = -1  #: greatest minus least delay of as many
    winding_c: float | None = None
    actor: int = 0  #: that changed something last
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
    #: what a tick takes of its period
    room: Room | None = None
    endpoints: dict[str, Any] = field(default_factory=dict)
    #: of the servo process: the rights that it was granted, its board and bus
    servo: dict[str, Any] = field(default_factory=dict)
    gateway: dict[str, Any] = field(default_factory=dict)  #: its process and its relay
    guard: GuardStatus | None = None
    events: tuple[Event, ...] = ()  #: the last ones of the topic `event`
    requests: dict[str, int] = field(default_factory=dict)  #: counts of them
