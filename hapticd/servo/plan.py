"""The servo's intended state (Plan) and the constants of one tick (TickConstants), both as plain
tuples (checkpoint).

A Plan is everything that changes by commands, ramps and transitions, and not by the sample. It is
immutable. `with_values` returns the next one for a change of settings, `commands.obey` for any
command. Ramps carry their own start tick, so a parameter that is set twice continues from its
present value. `tick_constants` computes the constants of a tick from it, and how long they hold.

A tick passes on a ServoState. Its part that changes with every sample is a plain tuple, which
CPython takes apart and builds at the speed of C. Its part that only `slow_path` changes is one
frozen object with named slots (TickConstants), which a calm tick passes on untouched.

A checkpoint (`flatten`, `unflatten`) is the whole state as nested plain tuples, the start of a
replay. Every number keeps its type and value, so a replay from a checkpoint gives the same bits as
the run that left it. Plain tuples are cheap to marshal (about 10 us, only at the gateway's request,
after the record was published) and survive JSON.

Limitations: a field of Plan or ServoState that is added there and not in `flatten` (the tests
replay and compare), a mutable value in a Plan.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from hapticd.core.environment import FIELDS, FURTHER, FilterParams, WorkspaceParams
from hapticd.core.params import ServoParams
from hapticd.core.units import round_half_up
from hapticd.mailbox import layout
from hapticd.mailbox.layout import (
    ANY_TERMS,
    COMMISSIONING,
    COMMISSIONING_LIMITS,
    Flag,
    Value,
    ValueLimit,
    following,
    value_limits,
)
from hapticd.render.law import (
    BIAS,
    Coefficients,
    LawInputs,
    LawState,
    Ledger,
    Ramp,
    approach,
    constant,
    design_coefficients,
)
from hapticd.render.winding import Winding
from hapticd.servo.homing import Homing
from hapticd.servo.safety import (
    FAULT_EVENT,
    GRANTED,
    LATCHED,
    Push,
    Signs,
    State,
    held_damping,
    watches,
)
from hapticd.usb.codec import U16_HIGHEST
from hapticd.usb.frames import OutFlag, StatusBit

__all__ = [
    "Request",
    "ServoState",
    "coefficients_of",
    "in_slots",
    "masked_places",
    "unflatten",
    "with_values",
]

NEVER = 1 << 62
CONTROL_SLEW_NS_PER_M_S: Final = 2000.0  # of active damping that the energy controller raises
Wave = tuple[int, int, bool]  # perturbation: number of its command (0: none), samples, loop
NO_WAVE: Wave = (0, 0, False)
WAVE_COMMAND: Final = 0  # place in a Wave
BUMPLESS = tuple(Value(one.slot) for one in FIELDS if one.ramped)
ADDED = frozenset({Value.ACTIVE_DAMPING, Value.ACTIVE_DAMPING_ON})  # active damping
FILTERED = (
    Value.VIRTUAL_DAMPING,
    Value.MASS,
    Value.WALL_VIRTUAL_DAMPING,
)  # act on filtered derivatives
FILTERS = frozenset(
    {
        Value.VELOCITY_FILTER_HZ,
        Value.VELOCITY_FILTER_ZETA,
        Value.ACCELERATION_FILTER_HZ,
        Value.ACCELERATION_FILTER_ZETA,
    }
)

JUDGED = FILTERS.union(BUMPLESS, ADDED)  # parameters that a verdict depends on


class Control(NamedTuple):
    """Actions of the energy controller (servo.energy)."""

    places: tuple[int, ...] = ()  # layout.Value: changed by it and not set by a client since
    tick: int = 0  # of its last step
    excess_j: float = 0.0  # at that step


class Proxy(NamedTuple):
    """The anchor of the virtual spring, which the law of a client moves (servo.proxy)."""

    owner: int = 0  # actor of the law, 0: none
    position_m: float = 0.0
    target_m: float = 0.0
    step_m: float = 0.0  # of a tick, on the way to the target
    asked_tick: int = 0  # of the target
    moved_tick: int = 0
    energy_j: float = 0.0  # put into the spring at that tick, less what was taken from it
    held: bool = False  # it does not follow its target
    ticks: int = 1  # between its last two targets


NO_PROXY: Final = Proxy()


class Plan(NamedTuple):
    """Intentions. Ramps in SI units; `added` are levels of active damping."""

    state: State
    since_tick: int  # at which `state` was entered
    fault: int  # number of its first cause, 0: none
    actor: int  # sender of the last change
    revision: int  # counts changes
    leases: tuple[int, int]  # actors that hold control and damping
    homed: bool
    origin: int  # encoder count at x = 0
    wave: Wave  # the playing perturbation
    gain: Ramp  # 0 to 1, of all rendered forces
    # N; the remaining force of a latched state without a valid sample
    fade: Ramp
    # by layout.Value: K, B, M and the wall; its side too, whose square scales the wall's force
    values: dict[int, Ramp]
    filters: tuple[FilterParams, FilterParams]  # of velocity and acceleration
    active_damping_asked: float  # active damping, N s/m
    active_damping_on: bool
    added: float  # slewed level, N s/m
    added_entry: float  # level when a latched state was entered, N s/m
    scheduled: tuple["Scheduled", ...]
    unauthorised: int = 0  # consecutive periods in which the board withheld requested torque
    homing: Homing = Homing()
    stop_tick: int = -1  # of the last press of a stop, -1: none since the last reset
    stop_owner: int = 0  # actor that pressed it; 0: several
    limit_cycle_faults: bool = False
    origin_used: bool = False  # it was set, or enabled at, in this life of the servo
    origin_lost: bool = False  # a used one was lost; it must be found again
    # encoder counts since the last sample that was believed, None for a lost one (servo.samples)
    doubted: tuple[int | None, ...] = ()
    glitches: tuple[int, ...] = ()  # slots of the newest glitches of this state
    environment_revision: int = 0  # counts changes of environment and damping
    bookings: tuple["Booking", ...] = ()  # of the last second (servo.energy)
    winding: Winding = Winding()  # with the compensation of its resistance
    control: Control = Control()
    push: Push = Push()  # followed while signs are not verified
    silent_until: int = 0  # slot of the first frame after a silence (servo.watchdog_trial), 0: none
    # slot since which withheld force has not been complete again, -1: it is complete
    short_since: int = -1
    terms: int = ANY_TERMS  # number of the gateway's terms, ANY_TERMS: none received
    proxy: Proxy = NO_PROXY


class Booking(NamedTuple):
    """Energy added by changes of parameters, within one share of a second."""

    share: int  # number of it, since tick 0
    energy_j: float


class Scheduled(NamedTuple):
    """A set that waits for its tick."""

    seq: int
    actor: int
    tick: int
    values: tuple[float, ...]
    terms: int = ANY_TERMS  # of the end of a bounded change: the terms of its judgement


def initial_plan(params: ServoParams) -> Plan:
    """Return the plan of a disabled servo, as configured, with active damping off."""
    environment = params.environment
    start = environment.row()
    table = params.device.resistance  # before the first reading of the winding
    return Plan(
        state=State.DISABLED,
        since_tick=0,
        fault=0,
        actor=0,
        revision=0,
        leases=(0, 0),
        homed=False,
        origin=0,
        wave=NO_WAVE,
        gain=constant(0.0),
        fade=constant(0.0),
        values={int(place): constant(boxed(place, start[place], params)) for place in BUMPLESS},
        filters=environment.filters,
        active_damping_asked=params.active_damping_ns_per_m,
        active_damping_on=False,
        added=0.0,
        added_entry=0.0,
        scheduled=(),
        limit_cycle_faults=params.safety.limit_cycle_faults,
        winding=Winding() if table is None else Winding.unheated(table),
    )


def boxed(place: Value, value: float, params: ServoParams) -> float:
    """Return `value` within the limits for a device whose signs are not verified."""
    if not params.device.commissioning or place not in COMMISSIONING_LIMITS:
        return value
    limit = COMMISSIONING_LIMITS[place]
    return max(limit.low, min(limit.high, value))


def with_origin(plan: Plan, encoder: int) -> Plan:
    """Return `plan` with the origin set at this count."""
    return plan._replace(origin=encoder, homed=True, origin_used=True, origin_lost=False)


def without_origin(plan: Plan) -> Plan:
    """Return `plan` with an unknown origin; one that was used must be found again."""
    return plan._replace(homed=False, origin_lost=plan.origin_lost or plan.origin_used)


def masked_places(values: tuple[float, ...]) -> list[int]:
    """Return the places of a command's values in its mask."""
    mask = int(values[Value.MASK])
    return [place for place in range(1, len(values)) if mask >> place & 1]


def names_places(values: tuple[float, ...]) -> bool:
    """Return whether `values` have a valid mask, which is finite."""
    return 0 <= values[Value.MASK] < 1 << len(values)


def out_of_range(values: tuple[float, ...], params: ServoParams) -> bool:
    """Return whether any masked value is not finite or beyond its limit.

    Limits are those of this device at this rate.
    """
    if not names_places(values):
        return True
    limits: dict[int, ValueLimit] = {
        int(place): limit
        for place, limit in value_limits(
            params.realtime.rate_hz,
            params.device.active_damping_limit_ns_per_m,
            params.device.commissioning,
        ).items()
    }
    return not all(
        place in limits and limits[place].low <= values[place] <= limits[place].high
        for place in masked_places(values)
    )


def with_values(
    plan: Plan, values: tuple[float, ...], tick: int, params: ServoParams
) -> tuple[Plan, int]:
    """Return `plan` on its ramps to the masked `values` from `tick` on, and the tick at which they
    end.

    ConfigError: filter refused.
    """
    places = masked_places(values)
    rate_hz = params.realtime.rate_hz
    ramp_s = values[Value.RAMP_S] if Value.RAMP_S in places else params.safety.default_ramp_s
    ticks = round_half_up(ramp_s * rate_hz)
    ramps = {
        place: plan.values[place].towards(values[place], tick, ticks)
        for place in places
        if place in plan.values
    }
    changed = plan._replace(
        values=plan.values | ramps,
        filters=_filters(plan.filters, places, values),
        revision=following(plan.revision),
        control=asked_again(plan.control, places),
    )
    if not JUDGED.isdisjoint(places):
        changed = changed._replace(environment_revision=following(plan.environment_revision))
    if Value.ACTIVE_DAMPING in places:
        changed = changed._replace(active_damping_asked=values[Value.ACTIVE_DAMPING])
    if Value.LIMIT_CYCLE_FAULTS in places:
        changed = changed._replace(limit_cycle_faults=values[Value.LIMIT_CYCLE_FAULTS] != 0.0)
    if Value.ACTIVE_DAMPING_ON in places:
        changed = changed._replace(active_damping_on=values[Value.ACTIVE_DAMPING_ON] != 0.0)
    leases = tuple(
        int(values[p]) if p in places else old
        for p, old in zip(
            (Value.LEASE_CONTROL, Value.LEASE_ACTIVE_DAMPING), plan.leases, strict=True
        )
    )
    return changed._replace(leases=(leases[0], leases[1])), tick + (ticks if ramps else 0)


def asked_again(control: Control, places: list[int]) -> Control:
    """Return `control` without the places that a change of `places` sets again."""
    if not control.places:
        return control
    named = {*places, *(ADDED if not ADDED.isdisjoint(places) else ())}
    return control._replace(places=tuple(one for one in control.places if one not in named))


def _filters(
    old: tuple[FilterParams, FilterParams], places: list[int], values: tuple[float, ...]
) -> tuple[FilterParams, FilterParams]:
    if FILTERS.isdisjoint(places):
        return old

    def one(params: FilterParams, hz: Value, zeta: Value) -> FilterParams:
        frequency_hz = values[hz] if hz in places else params.frequency_hz
        return FilterParams(
            frequency_hz, values[zeta] if zeta in places else params.damping_ratio, params.mapping
        )

    first = one(old[0], Value.VELOCITY_FILTER_HZ, Value.VELOCITY_FILTER_ZETA)
    return first, one(old[1], Value.ACCELERATION_FILTER_HZ, Value.ACCELERATION_FILTER_ZETA)


def coefficients_of(plan: Plan, rate_hz: float) -> Coefficients:
    """Return the filter coefficients of `plan`. ConfigError for an impossible corner."""
    return design_coefficients(*plan.filters, rate_hz)


@dataclass(frozen=True, slots=True)
class TickConstants:
    """The parts of the plan that a tick needs, in the form it needs; valid until the next
    transition.
    """

    wake_tick: int  # evaluate the plan again at this tick
    environment: LawInputs  # inputs of `render`
    coefficients: Coefficients  # of its filters
    out_flags: int  # of the OUT frame
    damping_count: int  # of the OUT frame
    blob: bytes  # layout.PLAN
    origin: int  # encoder count at x = 0
    host: int  # host flags it was made under
    wave: Wave  # the plan's
    watched: int  # status bits that the fast path compares
    calm: int  # and their values without a fault
    flags: int  # of every record
    plan: Plan
    resistance_count: int = 0  # of the OUT frame
    proxy_n: float = 0.0  # force of the spring at x = 0, because of the proxy


Former = tuple[LawState, Ledger]  # as they were before the last sample
Held = tuple[int, float, Former]  # last sent torque count and force [N]; states before them
ServoState = tuple[TickConstants, LawState, Ledger, Held, Signs]
SETTLED: Final = 0  # place in a ServoState
# encoder count, status, temperature count, arrival (usb.device), host flags, index offset, delay
# from the sample to the force in effect [periods], negative while it is unknown, counts of the
# motor's current and of the active damping in effect
Sample = tuple[int, int, int, int, int, int, float, int, int]
STATUS: Final = 1  # place in a Sample
# torque count, position, velocity, acceleration, force parts K B M field, force as sent, record
# flags, answers
Output = tuple[int, float, float, float, float, float, float, float, float, int, tuple[Any, ...]]
# seq, kind, actor, apply tick, values
Request = tuple[int, int, int, int, tuple[float, ...]]
KIND: Final = 1  # place in a Request


def in_slots(requests: tuple[Request, ...], lost: int) -> tuple[Request, ...]:
    """Return `requests` with their ticks as slots, when `lost` slots have no tick."""
    if not lost:
        return requests
    return tuple(
        (seq, kind, actor, apply_tick and apply_tick + lost, _until_slot(values, lost))
        for seq, kind, actor, apply_tick, values in requests
    )


def _until_slot(values: tuple[float, ...], lost: int) -> tuple[float, ...]:
    place = Value.UNTIL_TICK
    # not yet validated: the command refuses an invalid mask
    if not names_places(values) or place not in masked_places(values):
        return values
    return (*values[:place], values[place] + lost, *values[place + 1 :])


def fault_request(number: int) -> Request:
    """Return the servo's request to itself to enter the fault `number` (`faults.BY_NUMBER`)."""
    return 0, FAULT_EVENT, 0, 0, (float(number),)


# seq, result, fault, revision, (first tick, ramp-end tick), effective values
Answer = tuple[int, int, int, int, tuple[int, int], tuple[float, ...]]

# host flags
LINK_UP = 1
GATEWAY_ALIVE = 2
AMPLIFIER_TOLD = 4  # the board reports whether its amplifier is ready
DEVICE_DIFFERS = 8  # the board contradicts its device file (usb.search)
RATE_NOT_HELD = 16  # the bus is too slow for the rate (usb.search)
NO_TEMPERATURE = 32  # the board does not measure the winding: ignore its count
COMPENSATES = 64  # the board has a resistance DAC that it does not control itself

BOARD_FAULT = int(StatusBit.AMPLIFIER_FAULT | StatusBit.ENCODER_FAULT)
CLEARABLE = BOARD_FAULT | int(StatusBit.OVER_TEMPERATURE)  # that CLEAR_FAULT may end
ATTENTION = int(StatusBit.WATCHDOG | StatusBit.OVER_TEMPERATURE) | BOARD_FAULT
AUTHORITY = int(StatusBit.ENABLED)


def watch(flags: int) -> tuple[int, int]:
    """Return the status bits that count in the answer to an OUT frame with `flags`, and their
    values without a fault. They include authority if it was requested.
    """
    if flags & OutFlag.ENABLE:
        return ATTENTION | AUTHORITY, AUTHORITY
    return ATTENTION, 0


def added_target(plan: Plan, tick: int, params: ServoParams) -> float:
    """Return the level of active damping [N s/m] of the table at `tick`, before the slew limit."""
    if plan.state in LATCHED:
        return held_damping(
            plan.added_entry, (tick - plan.since_tick) / params.realtime.rate_hz, params.safety
        )
    return plan.active_damping_asked if plan.active_damping_on else 0.0


def advance_added(plan: Plan, tick: int, elapsed: int, params: ServoParams) -> Plan:
    """Return `plan` with its active damping advanced by `elapsed` periods. It is slew-limited,
    except for the release from a latched state, which is on time.
    """
    target = added_target(plan, tick, params)
    releasing = plan.state in LATCHED and target < plan.added
    slew = params.safety.active_damping_slew_ns_per_m_s
    if Value.ACTIVE_DAMPING in plan.control.places and target > plan.added:
        slew = max(slew, CONTROL_SLEW_NS_PER_M_S)
    step = elapsed * slew / params.realtime.rate_hz
    added = target if releasing else approach(plan.added, target, step)
    return plan if added == plan.added else plan._replace(added=added)


def damping_count(level: float, params: ServoParams) -> int:
    """Return the DAC count for `level` [N s/m], inside the DAC and the device's limit."""
    return params.device.active_damping.to_count(
        min(level, params.device.active_damping_limit_ns_per_m), 0, U16_HIGHEST
    )


def tick_constants(
    plan: Plan,
    tick: int,
    params: ServoParams,
    environment: LawInputs,
    coefficients: Coefficients,
    flags: int,
    host: int,
) -> TickConstants:
    """Return the constants of the ticks from `tick` on. `plan` renders `environment`, with `flags`
    in its OUT frames.
    """
    gain = plan.gain.value(tick)
    at = {place: ramp.value(tick) for place, ramp in plan.values.items()}
    count = damping_count(plan.added, params)
    blob = layout.PLAN.pack(
        plan.revision,
        plan.state,
        plan.fault,
        plan.wave[WAVE_COMMAND] != 0,
        plan.homed,
        plan.actor,
        *plan.leases,
        gain,
        at[Value.STIFFNESS],
        at[Value.VIRTUAL_DAMPING],
        at[Value.MASS],
        added_target(plan, tick, params),
        params.device.active_damping.to_value(count),
        at[Value.WALL_STIFFNESS],
        at[Value.WALL_POSITION],
        *(at[one.slot] for one in FURTHER),
        plan.proxy.position_m,
        round(at[Value.WALL_SIDE]),
        watches(params, plan.limit_cycle_faults) | COMMISSIONING * params.device.commissioning,
        plan.environment_revision,
        plan.winding.dac_count,
    )
    watched, calm = watch(flags)
    return TickConstants(
        wake_tick=min(wake_tick(plan, tick, params), proxy_tick(plan, tick, params)),
        environment=environment,
        coefficients=coefficients,
        out_flags=flags,
        damping_count=count,
        blob=blob,
        origin=plan.origin,
        host=host,
        wave=plan.wave,
        watched=watched,
        calm=calm,
        flags=standing_flags(plan),
        plan=plan,
        resistance_count=plan.winding.dac_count,
        proxy_n=environment[BIAS] if plan.proxy.position_m else 0.0,
    )


def standing_flags(plan: Plan) -> int:
    """Return the flags of every record while `plan` holds."""
    controlled = int(Flag.CONTROLLED) if plan.control.places else 0
    return controlled | int(Flag.PROXY_HELD) if plan.proxy.held else controlled


def environment_of(plan: Plan, tick: int, workspace: WorkspaceParams, limit_n: float) -> LawInputs:
    """Return the inputs of the law at `tick`.

    K-B-M, walls, ends of the workspace and the limit all include the gain. A force at its limit
    therefore follows the ramp too.
    """
    gain = plan.gain.value(tick)
    at = plan.values
    # a force from outside the law: the fading push of a stopped homing
    push = plan.fade.value(tick) if plan.state in LATCHED and plan.gain.start == 0.0 else 0.0
    bias = push
    if plan.proxy.position_m and not push:  # the spring acts on the distance from it
        bias = gain * at[Value.STIFFNESS].value(tick) * plan.proxy.position_m
    return (
        gain * at[Value.STIFFNESS].value(tick),
        gain * at[Value.VIRTUAL_DAMPING].value(tick),
        gain * at[Value.MASS].value(tick),
        bias,
        limit_n if push else gain * limit_n,
        gain * at[Value.WALL_STIFFNESS].value(tick),
        gain * at[Value.WALL_VIRTUAL_DAMPING].value(tick),
        at[Value.WALL_POSITION].value(tick),
        at[Value.WALL_SIDE].value(tick),
        workspace.lower_m,
        workspace.upper_m,
        gain * workspace.stiffness_n_per_m,
        *(gain * at[one.slot].value(tick) for one in FURTHER),
    )


def wake_tick(plan: Plan, tick: int, params: ServoParams) -> int:
    """Return the first tick after `tick` at which the plan gives other values than now."""
    ramps = (plan.gain, plan.fade, *plan.values.values())
    if (
        plan.state is State.HOMING
        or plan.unauthorised
        or plan.doubted
        or plan.silent_until
        or (params.device.commissioning and plan.state in GRANTED)
        or any(ramp.running(tick) for ramp in ramps)
        or plan.added != added_target(plan, tick, params)
    ):
        return tick + 1
    events = [one.tick for one in plan.scheduled]
    if params.device.resistance is not None:
        events.append(plan.winding.due_tick)
    if plan.state in LATCHED:
        held = plan.since_tick + round_half_up(
            params.safety.active_damping_hold_s * params.realtime.rate_hz
        )
        if plan.added > 0.0:
            events.append(max(held, tick + 1))
    return min(events, default=NEVER)


def proxy_tick(plan: Plan, tick: int, params: ServoParams) -> int:
    """Return the first tick after `tick` at which the proxy moves or its target expires."""
    proxy = plan.proxy
    if not proxy.owner:
        return NEVER
    late = proxy.asked_tick + proxy_ticks(params) + 1
    if plan.state is State.ENABLED and tick >= late:
        return NEVER
    return tick + 1 if proxy.position_m != proxy.target_m else max(late, tick + 1)


def proxy_ticks(params: ServoParams) -> int:
    """Return the ticks for which a target of the proxy is valid, at least 1."""
    return max(1, round_half_up(params.safety.proxy_timeout_s * params.realtime.rate_hz))


def flatten(state: ServoState) -> tuple[Any, ...]:
    """Return `state` as tuples, numbers and text."""
    settled, law, ledger, held, signs = state
    plan = settled.plan
    plain = plan._asdict() | {
        "state": int(plan.state),
        "gain": tuple(plan.gain),
        "fade": tuple(plan.fade),
        "values": tuple((place, tuple(ramp)) for place, ramp in plan.values.items()),
        "filters": tuple(
            (one.frequency_hz, one.damping_ratio, one.mapping) for one in plan.filters
        ),
        "scheduled": tuple(tuple(one) for one in plan.scheduled),
        "homing": tuple(plan.homing),
        "bookings": tuple(tuple(one) for one in plan.bookings),
        "winding": tuple(plan.winding),
        "control": tuple(plan.control),
        "push": tuple(plan.push),
        "proxy": tuple(plan.proxy),
    }
    return (
        settled.wake_tick,
        settled.environment,
        settled.coefficients,
        settled.out_flags,
        settled.damping_count,
        settled.blob.hex(),
        law,
        ledger,
        settled.origin,
        tuple(signs),
        held,
        settled.host,
        tuple(plain.values()),
    )


def unflatten(plain: Sequence[Any]) -> ServoState:
    """Return the state in `plain`, whose tuples may have become lists."""
    wake, environment, coefficients, flags, damping, blob, *others, plan = map(_tuples, plain)
    fields = dict(zip(Plan._fields, plan, strict=True))
    first, second = (FilterParams(*one) for one in fields["filters"])
    renewed = fields | {
        "state": State(fields["state"]),
        "gain": Ramp(*fields["gain"]),
        "fade": Ramp(*fields["fade"]),
        "values": {place: Ramp(*ramp) for place, ramp in fields["values"]},
        "filters": (first, second),
        "scheduled": tuple(Scheduled(*one) for one in fields["scheduled"]),
        "homing": Homing(*fields["homing"]),
        "bookings": tuple(Booking(*one) for one in fields["bookings"]),
        "winding": Winding(*fields["winding"]),
        "control": Control(*fields["control"]),
        "push": Push(*fields["push"]),
        "proxy": Proxy(*fields["proxy"]),
    }
    law, ledger, origin, signs, held, host = others
    before = wake, environment, coefficients, flags, damping, bytes.fromhex(blob)
    whole = Plan(**renewed)
    looks = watch(flags)
    of_plan = standing_flags(whole)
    more = whole.winding.dac_count, environment[BIAS] if whole.proxy.position_m else 0.0
    settled = TickConstants(*before, origin, host, whole.wave, *looks, of_plan, whole, *more)
    return settled, law, ledger, held, Signs(*signs)


def _tuples(item: Any) -> Any:
    return tuple(map(_tuples, item)) if isinstance(item, list | tuple) else item
