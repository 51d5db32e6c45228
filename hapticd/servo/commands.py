"""One command on one plan: the next plan and the answer.

Every accepted change gets its own receipt, and a refused one changes nothing.

`safety` defines the state that a command leads to. This module checks the other conditions (a
board, an origin, a cause that persists, another client's stop). It also sets everything that
depends on the state: the ramps of gain and force, the damping circuit, activities that end, and
whether the origin is still valid. A stop ramps down the force that acts with authority in its tick,
once: no order or repetition of commands makes force.

A state is entered through `enter` only, and an answer is given only when the plan is as it reports.
"""

from collections.abc import Iterable, Sequence
from math import inf
from typing import NamedTuple

from hapticd.core.environment import Environment
from hapticd.core.errors import ConfigError
from hapticd.core.faults import BY_CODE
from hapticd.core.params import ServoParams
from hapticd.core.units import round_half_up
from hapticd.mailbox.layout import (
    ANY_TERMS,
    COMMAND_VALUES,
    STRENGTH_VALUES,
    Command,
    Result,
    Value,
    following,
    values_of,
)
from hapticd.render.law import Ramp, constant
from hapticd.servo import safety, watchdog_trial
from hapticd.servo.homing import begin
from hapticd.servo.plan import (
    FILTERED,
    NO_WAVE,
    Answer,
    Plan,
    Request,
    Scheduled,
    coefficients_of,
    damping_count,
    masked_places,
    names_places,
    out_of_range,
    with_origin,
    with_values,
    without_origin,
)
from hapticd.servo.proxy import aimed, without_proxy
from hapticd.servo.safety import GRANTED, LATCHED, Push, State

# faults that the gateway may detect and request
FROM_GATEWAY = frozenset({BY_CODE["damping_not_delivered"].number})

MOST_SCHEDULED = 16
# places of a bounded change that its end does not restore
UNBOUNDED = frozenset({Value.ENVIRONMENT_REVISION, Value.TERMS, Value.UNTIL_TICK})
STRENGTHS = frozenset({*STRENGTH_VALUES, Value.WALL_SIDE})
SETTINGS = frozenset({Command.SET, Command.DAMPING})
# commands without a sender
DISOWNED: dict[int, Result] = {
    safety.ORPHANED_EVENT: Result.REFUSED_NO_GATEWAY,
    Command.WITHDRAWN: Result.CANCELLED,
}
# commands with a mask
MASKED = SETTINGS | {
    Command.CANCEL, Command.WITHHOLD, Command.ENABLE, Command.PERTURB_START, Command.TERMS,
    Command.PROXY,
}  # fmt: skip
STOP_HELD_S = 1.0  # after a press, only its actor may reset
WAVEFORM = frozenset({Value.SAMPLES, Value.LOOP})  # required by a perturbation
# faults after which the encoder's count is not trusted
ENCODER_LIES = frozenset({BY_CODE["sensor_range"].number, BY_CODE["sensor_glitch"].number})


class CommandContext(NamedTuple):
    """The conditions of a command besides the plan."""

    tick: int
    last_tick: int  # the tick whose parameters made the acting force
    encoder: int
    force_n: float  # as last sent; 0 if the board has withdrawn it
    gateway: bool
    cause: int  # number of the fault that would occur under force now, 0: none
    bar: Result | None = None  # why this board may make no force at all
    believed: bool = True  # `encoder` arrived in this tick and continues the samples before it
    heard: bool = True  # frames show whether the board grants torque


def answer(
    plan: Plan, seq: int, result: Result, ticks: tuple[int, int], params: ServoParams
) -> Answer:
    """Return the receipt: result, revision, ticks and the effective values, after quantisation."""
    return seq, int(result), plan.fault, plan.revision, ticks, _effective(plan, params)


def _effective(plan: Plan, params: ServoParams) -> tuple[float, ...]:
    effective = [0.0] * COMMAND_VALUES
    for place, value in target(plan, params).row().items():
        effective[place] = value
    effective[Value.ACTIVE_DAMPING_ON] = float(plan.active_damping_on)
    effective[Value.LIMIT_CYCLE_FAULTS] = float(plan.limit_cycle_faults)
    effective[Value.LEASE_CONTROL], effective[Value.LEASE_ACTIVE_DAMPING] = plan.leases
    effective[Value.STOP_OWNER] = plan.stop_owner
    effective[Value.ENVIRONMENT_REVISION] = plan.environment_revision
    return tuple(effective)


def target(plan: Plan, params: ServoParams) -> Environment:
    """Return the end of the ramps of `plan`, with its level of active damping as quantised."""
    velocity, acceleration = plan.filters
    count = damping_count(plan.active_damping_asked, params)
    found = Environment(
        velocity_filter=velocity,
        acceleration_filter=acceleration,
        active_damping_ns_per_m=params.device.active_damping.to_value(count),
    )
    return found.with_slots({place: ramp.end for place, ramp in plan.values.items()})


def force_acts(plan: Plan, tick: int) -> bool:
    """Return whether force acts by the authority of `plan`'s state. Authority that was granted in
    this tick, also after a disable or reset in it, has not reached the board.
    """
    return plan.state in GRANTED and plan.since_tick < tick


def enter(
    plan: Plan, state: State, now: CommandContext, params: ServoParams, actor: int, fault: int = 0
) -> Plan:
    """Return `plan` in `state`, with gain, remaining force, damping and perturbation from the
    safety table.
    """
    gain, fade = _ramps_into(plan, state, now, params)
    entered = plan._replace(
        state=state,
        since_tick=now.tick,
        fault=fault,
        actor=actor,
        push=Push(),
        silent_until=0,
        gain=gain,
        fade=fade,
        glitches=(),
        short_since=-1,
        revision=following(plan.revision),
    )
    if state not in LATCHED:
        entered = without_proxy(entered)
    if state is not State.ENABLED:
        # a trial may have switched the faults off: restore the configuration
        default = params.safety.limit_cycle_faults
        entered = entered._replace(wave=NO_WAVE, limit_cycle_faults=default)
    if state in LATCHED:
        entered = entered._replace(added_entry=plan.added)
    return _origin_kept(entered, now)


def _ramps_into(
    plan: Plan, state: State, now: CommandContext, params: ServoParams
) -> tuple[Ramp, Ramp]:
    """Return the ramps of the force into a state. They are those of the law's gain, and of the last
    sent force [N] for ticks without a sample.
    """
    rate_hz = params.realtime.rate_hz
    limits = params.safety
    gain = constant(0.0)
    fade = constant(0.0)
    if state is State.ENABLED:
        gain = Ramp(0.0, 1.0, now.tick, round_half_up(limits.enable_ramp_s * rate_hz))
    if state in LATCHED and force_acts(plan, now.tick):
        ticks = round_half_up(limits.stop_ramp_s * rate_hz)
        # from the value in force, not from its ramp: easing may have held it back
        gain = Ramp(plan.gain.value(now.last_tick), 0.0, now.tick, ticks)
        fade = Ramp(now.force_n, 0.0, now.tick, ticks)
    if state in LATCHED and plan.state in LATCHED:  # a fade does not restart
        gain = plan.gain
        fade = plan.fade
    return gain, fade


def _origin_kept(entered: Plan, now: CommandContext) -> Plan:
    """Return `entered`, a state just entered, with the effect on the position origin."""
    if entered.state is State.ENABLED:
        return entered._replace(origin_used=True)
    if entered.state is State.HOMING:  # a request for an origin discards the present one
        lost = without_origin(entered._replace(origin_used=True))
        return lost._replace(homing=begin(now.tick, now.encoder))
    return without_origin(entered) if entered.fault in ENCODER_LIES else entered


def obey(
    plan: Plan, request: Request, now: CommandContext, params: ServoParams
) -> tuple[Plan, list[Answer]]:
    """Return `plan` after `request`, with its receipts; a refused request changes nothing."""
    seq, kind, actor, _, values = request
    if kind in DISOWNED:
        return plan, [answer(plan, seq, DISOWNED[kind], (now.tick, now.tick), params)]
    if kind in MASKED and not names_places(values):
        return plan, [answer(plan, seq, Result.REFUSED_RANGE, (now.tick, now.tick), params)]
    if kind in SETTINGS:
        return _settings(plan, request, now, params)
    if kind == Command.FAULT:
        number = values[Value.FAULT_NUMBER]
        if number not in FROM_GATEWAY or plan.state not in GRANTED:
            refusal = Result.REFUSED_STATE if number in FROM_GATEWAY else Result.REFUSED_RANGE
            return plan, [answer(plan, seq, refusal, (now.tick, now.tick), params)]
        return obey(plan, (seq, safety.FAULT_EVENT, actor, 0, (number,)), now, params)
    if kind == Command.CANCEL:
        return _cancel(plan, request, now, params)
    if kind == Command.TERMS:
        return _terms(plan, request, now, params)
    if kind == Command.WITHHOLD:
        after, result = watchdog_trial.begun(plan, values, now.tick, params)
        end = max(now.tick, after.silent_until)
        return after, [answer(after, seq, result, (now.tick, end), params)]
    if kind == Command.PROXY:  # not answered: the records show it
        return aimed(plan, request, now.tick, params), []
    target = _target(plan, request, now, params)
    if isinstance(target, Result):
        until = held_until(plan, params) if target is Result.REFUSED_OWNER else now.tick
        return plan, [answer(plan, seq, target, (now.tick, until), params)]
    after = plan
    end = now.tick
    cancelled: list[Answer] = []
    if target is not plan.state:
        fault = (
            int(values[0])
            if kind == safety.FAULT_EVENT
            else safety.STOP_FAULT
            if target is State.STOPPED
            else 0
        )
        after = enter(plan, target, now, params, actor, fault)
        end = max(
            after.gain.start_tick + after.gain.ticks,
            after.fade.start_tick + after.fade.ticks,
            now.tick,
        )
    if kind == Command.STOP or (kind == safety.FAULT_EVENT and target is not plan.state):
        after = after._replace(scheduled=())
        cancelled = [
            answer(after, one.seq, Result.CANCELLED, (one.tick, one.tick), params)
            for one in plan.scheduled
        ]
    after = _action(after, request, now, params)
    receipt = [answer(after, seq, Result.APPLIED, (now.tick, end), params)] if seq else []
    return after, cancelled + receipt


def held_until(plan: Plan, params: ServoParams) -> int:
    """Return the first tick at which any client may reset a stop; 0 without one."""
    if plan.stop_tick < 0:
        return 0
    return plan.stop_tick + round_half_up(STOP_HELD_S * params.realtime.rate_hz)


def _pressed(plan: Plan, actor: int, now: CommandContext, params: ServoParams) -> Plan:
    """Return `plan` after a press of stop by `actor`. If another's press still holds, no client may
    reset it before its time.
    """
    others = now.tick < held_until(plan, params) and actor != plan.stop_owner
    return plan._replace(stop_tick=now.tick, stop_owner=0 if others else actor)


def _target(
    plan: Plan, request: Request, now: CommandContext, params: ServoParams
) -> State | Result:
    _, kind, actor, _, values = request
    target = safety.transition(plan.state, kind)
    if isinstance(target, Result) or target is plan.state:
        if kind == Command.ZERO and target is plan.state and not now.believed:
            return Result.REFUSED_SAMPLE
        if kind == Command.PERTURB_START and (
            out_of_range(values, params) or not WAVEFORM.issubset(masked_places(values))
        ):
            return Result.REFUSED_RANGE
        if kind == Command.PERTURB_START and target is plan.state:
            return _mute(plan, now) or target
        return target
    if target is State.HOMING and params.device.home.method == "none":
        return Result.REFUSED_STATE
    if target is State.HOMING and params.device.commissioning:
        return Result.REFUSED_COMMISSIONING
    if target is State.ENABLED and (refused := judged_otherwise(plan, values)):
        return refused
    if target in (State.ENABLED, State.HOMING):
        required = target is State.ENABLED and (params.device.home.required or plan.origin_lost)
        refusal = safety.enable_refusal(plan.homed, required, now.gateway, now.cause)
        return now.bar or refusal or target
    if kind == Command.RESET and now.tick < held_until(plan, params) and actor != plan.stop_owner:
        return Result.REFUSED_OWNER
    if kind == Command.RESET and now.cause:
        return Result.REFUSED_CAUSE
    return target


def _mute(plan: Plan, now: CommandContext) -> Result | None:
    """Return why no perturbation may start while force is withheld; it would play at its return."""
    if not now.heard:
        return Result.REFUSED_CAUSE
    return Result.REFUSED_NO_AUTHORITY if plan.unauthorised else None


def _action(plan: Plan, request: Request, now: CommandContext, params: ServoParams) -> Plan:
    seq, kind, actor, _, values = request
    if kind == Command.STOP:
        return _pressed(plan, actor, now, params)
    if kind == Command.RESET:
        return plan._replace(stop_tick=-1, stop_owner=0)
    if kind == Command.ZERO:
        return with_origin(plan, now.encoder)._replace(revision=following(plan.revision))
    if kind == Command.PERTURB_START:
        return plan._replace(
            wave=(seq, int(values[Value.SAMPLES]), bool(values[Value.LOOP])),
            revision=following(plan.revision),
        )
    if kind in (Command.PERTURB_STOP, safety.PERTURB_DONE_EVENT):
        return plan._replace(wave=NO_WAVE, revision=following(plan.revision))
    return plan


def _settings(
    plan: Plan, request: Request, now: CommandContext, params: ServoParams
) -> tuple[Plan, list[Answer]]:
    seq, _, actor, apply_tick, values = request
    here = (now.tick, now.tick)
    if out_of_range(values, params):
        return plan, [answer(plan, seq, Result.REFUSED_RANGE, here, params)]
    at = apply_tick or now.tick
    if at < now.tick or _until(values) <= at:
        return plan, [answer(plan, seq, Result.REFUSED_LATE, here, params)]
    if at > now.tick:
        return _schedule(plan, Scheduled(seq, actor, at, values), params)
    if _taken(plan.scheduled) + bounded(values) > MOST_SCHEDULED:
        return plan, [answer(plan, seq, Result.REFUSED_FULL, here, params)]
    return apply_settings(plan, Scheduled(seq, actor, at, values), params)


def _until(values: tuple[float, ...]) -> float:
    """Return the slot at which the change in `values` ends; infinity without an end."""
    return values[Value.UNTIL_TICK] if bounded(values) else inf


def bounded(values: tuple[float, ...]) -> bool:
    """Return whether the change in `values` has an end."""
    return Value.UNTIL_TICK in masked_places(values)


def _taken(scheduled: Sequence[Scheduled]) -> int:
    """Return the entries of MOST_SCHEDULED that `scheduled` takes: a bounded change has one for its
    end.
    """
    return sum(1 + bounded(one.values) for one in scheduled)


def _in_order(scheduled: Iterable[Scheduled]) -> tuple[Scheduled, ...]:
    return tuple(sorted(scheduled, key=lambda one: (one.tick, one.seq)))


def _schedule(plan: Plan, new: Scheduled, params: ServoParams) -> tuple[Plan, list[Answer]]:
    places = set(masked_places(new.values))
    gone = [
        old
        for old in plan.scheduled
        if old.tick == new.tick and places.issuperset(masked_places(old.values)) and not _ends(old)
    ]
    kept = tuple(old for old in plan.scheduled if old not in gone)
    if _taken((*kept, new)) > MOST_SCHEDULED:
        return plan, [answer(plan, new.seq, Result.REFUSED_FULL, (new.tick, new.tick), params)]
    after = plan._replace(scheduled=_in_order((*kept, new)))
    answers = [
        answer(plan, old.seq, Result.SUPERSEDED, (old.tick, old.tick), params) for old in gone
    ]
    return after, [*answers, answer(plan, new.seq, Result.SCHEDULED, (new.tick, new.tick), params)]


def _cancel(
    plan: Plan, request: Request, now: CommandContext, params: ServoParams
) -> tuple[Plan, list[Answer]]:
    """Cancel the scheduled changes of these places by other actors, each as a whole."""
    seq, _, actor, _, values = request
    here = (now.tick, now.tick)
    places = masked_places(values)
    gone = [
        one
        for one in plan.scheduled
        if one.actor != actor
        and not set(places).isdisjoint(masked_places(one.values))
        and not _stays(one, plan)
    ]
    after, answers = _without(plan, gone, params)
    return after, [*answers, answer(after, seq, Result.APPLIED, here, params)]


def _ends(one: Scheduled) -> bool:
    """Return whether it is the end of a bounded change."""
    return Value.TERMS in masked_places(one.values) and one.values[Value.TERMS] == ANY_TERMS


def _stays(one: Scheduled, plan: Plan) -> bool:
    """Return whether it is such an end, and each of its strengths stays or goes towards 0."""
    named = STRENGTHS.intersection(masked_places(one.values))
    ways = ((one.values[at], plan.values[at].end) for at in named)
    return _ends(one) and all(min(now, 0.0) <= value <= max(now, 0.0) for value, now in ways)


def _without(plan: Plan, gone: list[Scheduled], params: ServoParams) -> tuple[Plan, list[Answer]]:
    after = plan._replace(scheduled=tuple(one for one in plan.scheduled if one not in gone))
    ends = [(one.seq, (one.tick, one.tick)) for one in gone]
    return after, [answer(after, seq, Result.CANCELLED, at, params) for seq, at in ends]


def _terms(
    plan: Plan, request: Request, now: CommandContext, params: ServoParams
) -> tuple[Plan, list[Answer]]:
    """Set the terms in force from now on. Changes scheduled under other terms are cancelled, except
    ends of bounded changes that only lower. These apply at once, so that later verdicts count them.
    """
    seq, _, _, _, values = request
    here = (now.tick, now.tick)
    if out_of_range(values, params) or Value.TERMS not in masked_places(values):
        return plan, [answer(plan, seq, Result.REFUSED_RANGE, here, params)]
    number = int(values[Value.TERMS])
    others = [
        one
        for one in plan.scheduled
        if (one.terms if _ends(one) else one.values[Value.TERMS]) != number
    ]
    gone = [one for one in others if not _stays(one, plan)]
    after, answers = _without(plan._replace(terms=number), gone, params)
    after = after._replace(
        scheduled=_in_order(
            one._replace(tick=now.tick) if one in others else one for one in after.scheduled
        )
    )
    return after, [*answers, answer(after, seq, Result.APPLIED, here, params)]


def judged_otherwise(plan: Plan, values: tuple[float, ...]) -> Result | None:
    """Return why the change in `values` may not take effect. It was judged for another environment
    than that of `plan`, or by other terms.
    """
    named = masked_places(values)
    if Value.TERMS in named and values[Value.TERMS] not in (plan.terms, ANY_TERMS):
        return Result.REFUSED_TERMS
    revision = plan.environment_revision
    if Value.ENVIRONMENT_REVISION in named and values[Value.ENVIRONMENT_REVISION] != revision:
        return Result.REFUSED_REVISION
    return None


def apply_settings(plan: Plan, one: Scheduled, params: ServoParams) -> tuple[Plan, list[Answer]]:
    """Apply the settings of `one` at its tick. An end that lowers applies in any case."""
    if (refused := judged_otherwise(plan, one.values)) and not _stays(one, plan):
        return plan, [answer(plan, one.seq, refused, (one.tick, one.tick), params)]
    try:
        after, end = with_values(plan, one.values, one.tick, params)
        coefficients_of(after, params.realtime.rate_hz)
    except ConfigError:
        return plan, [answer(plan, one.seq, Result.REFUSED_RANGE, (one.tick, one.tick), params)]
    if after.filters != plan.filters and not filters_idle(plan, one.tick):
        return plan, [answer(plan, one.seq, Result.REFUSED_FILTER, (one.tick, one.tick), params)]
    after = after._replace(actor=one.actor)
    if bounded(one.values):
        after = after._replace(scheduled=_in_order((*after.scheduled, _end(plan, one, params))))
    return after, [answer(after, one.seq, Result.APPLIED, (one.tick, end), params)]


def _end(before: Plan, one: Scheduled, params: ServoParams) -> Scheduled:
    """Return the end of `one`, which restores the values of `before`. Without terms, it is bound to
    the environment that `one` leaves: that of a strict client, whose policy lets other clients
    change the environment without a verdict.
    """
    effective = list(_effective(before, params))
    for end in before.scheduled:  # do not restore values that end by then
        if _ends(end) and end.tick <= one.values[Value.UNTIL_TICK]:
            for place in masked_places(end.values):
                effective[place] = end.values[place]
    own = {
        Value.RAMP_S: one.values[Value.RAMP_S],
        Value.ENVIRONMENT_REVISION: float(following(before.environment_revision)),
    }
    given = {
        Value(place): own.get(Value(place), effective[place])
        for place in masked_places(one.values)
        if place not in UNBOUNDED
        or (place == Value.ENVIRONMENT_REVISION and one.values[Value.TERMS] == ANY_TERMS)
    }
    values = values_of(given | {Value.TERMS: float(ANY_TERMS)})
    return Scheduled(one.seq, one.actor, int(one.values[Value.UNTIL_TICK]), values, before.terms)


def filters_idle(plan: Plan, tick: int) -> bool:
    """Return whether no force passes the filters at `tick`. No force acts, or B, M and the wall's
    damping are 0 and do not ramp. Homing brakes through the velocity filter.
    """
    if plan.state is State.HOMING:
        return False
    off = plan.gain.end == 0.0 and not plan.gain.running(tick)
    filtered = [plan.values[place] for place in FILTERED]
    return off or not any(ramp.end or ramp.running(tick) for ramp in filtered)
