"""The long way of a tick: lost frames, causes of faults, commands, ramps, homing. It ends in a
state for the short way.

Order within a tick: what arrived -> what is wrong -> commands -> scheduled changes -> homing ->
damping and ramps. So a stop that arrives with an enable wins, and a fault that appears in this tick
is seen by a reset in the same tick.

What would break it: another order within a tick, or a change of the plan that leaves `Settled` as
it was (the short way looks at nothing else).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from hapticd.core.environment import FURTHER
from hapticd.core.faults import BY_CODE
from hapticd.core.params import ServoParams
from hapticd.core.units import round_half_up
from hapticd.mailbox.layout import Command, Flag, Result
from hapticd.render.energy import EXCESS, FORCE, Ledger, book
from hapticd.render.energy import at_rest as unknown_before
from hapticd.render.filters import steady
from hapticd.render.law import (
    LIMIT,
    MASS,
    Coefficients,
    LawInputs,
    LawState,
    at_rest,
    clamp,
    render,
    split,
)
from hapticd.render.ramp import Ramp, constant
from hapticd.servo import silence
from hapticd.servo.commands import Now, apply_settings, enter, obey
from hapticd.servo.commissioning import followed, push_ended
from hapticd.servo.compensation import compensated
from hapticd.servo.easing import eased
from hapticd.servo.energy_controller import controlled
from hapticd.servo.glitch import Verdict, believed_bend_m, verdict
from hapticd.servo.homing import Failed, Homing, Search, Seen, force_limit_n
from hapticd.servo.monitors import CALM, OVERSPEED, bounds
from hapticd.servo.plan import (
    AMPLIFIER_TOLD,
    AUTHORITY,
    BOARD_FAULT,
    DEVICE_DIFFERS,
    GATEWAY_ALIVE,
    KIND,
    LINK_UP,
    NO_TEMPERATURE,
    NO_WAVE,
    RATE_NOT_HELD,
    SETTLED,
    STATUS,
    WAVE_COMMAND,
    Answer,
    Plan,
    Request,
    Sample,
    ServoState,
    advance_added,
    coefficients_of,
    fault_request,
    flat_plan,
    settle,
    with_origin,
    without_origin,
)
from hapticd.servo.safety import GRANTED, LATCHED, State
from hapticd.usb.codec import I16_HIGHEST, I16_LOWEST
from hapticd.usb.device import SEED
from hapticd.usb.frames import OutFlag, StatusBit
from hapticd.usb.session import ENCODER_BITS

__all__ = ["refiltered"]

NO_AUTHORITY = BY_CODE["no_authority"].number
FRAMES_LOST = BY_CODE["frames_lost"].number
SENSOR_GLITCH = BY_CODE["sensor_glitch"].number
SHORT_S = 1.0  # beside the ramp of enabling: until force that is withheld again is given up
RESOLVED = int(Flag.INTERPOLATED | Flag.GLITCH | Flag.BELIEVED)  # of a sample that is believed
UNHEARD = 3  # ticks in a row without a frame: torque is not taken to be granted (ADR-0011)

Attend = Callable[
    [ServoState, tuple[Any, ...], Sample, int], tuple[ServoState, bool, tuple[Any, ...], int]
]


def make_attend(params: ServoParams) -> Attend:
    """`attend(state, commands, sample, tick)` -> (state, whether the sample may be used,
    answers, record flags).
    """
    rate_hz = params.realtime.rate_hz
    force = params.device.force
    own = bounds(params)
    own_resistance = own.resistance
    kept = own.kept
    limit_n = params.force_limit_n
    low_count, high_count = params.device.temperature_counts(I16_LOWEST, I16_HIGHEST)
    m_per_count = params.device.position.per_count * params.device.position.sign
    bend_m = believed_bend_m(params)
    first_origin = round_half_up(params.device.position.offset_count)
    home = params.device.home
    position = params.device.position
    home_counts = round_half_up(position.sign * home.position_m / position.per_count)
    search = Search(params)
    homing_limit_n = force_limit_n(params)
    longest_short = round_half_up((params.safety.enable_ramp_s + SHORT_S) * rate_hz)

    def cause(status: int, temperature: int, host: int) -> int:
        """Number of what is wrong at this moment, 0 if nothing is."""
        if not host & LINK_UP:
            return BY_CODE["usb_lost"].number
        if status & BOARD_FAULT:
            return BY_CODE["board_fault"].number
        allowed = low_count <= temperature <= high_count or host & NO_TEMPERATURE
        if status & StatusBit.OVER_TEMPERATURE or not allowed:
            return BY_CODE["over_temperature"].number
        return 0

    def cause_under_force(sample: Sample) -> int:
        """As `cause`, with what is harmless as long as there is no force: it keeps from
        enabling and from a reset.
        """
        _, status, temperature, arrival, host, _, _, _, _ = sample
        if found := cause(status, temperature, host):
            return found
        if status & StatusBit.WATCHDOG:
            return BY_CODE["board_watchdog"].number
        return FRAMES_LOST if -arrival > params.safety.missing_frames_limit else 0

    def cause_against_force(sample: Sample) -> int:
        """As `cause_under_force`, with what may pass within a few ticks under force (contacts
        bounce): it keeps from enabling and from a reset too.
        """
        _, status, _, _, host, _, _, _, _ = sample
        if found := cause_under_force(sample):
            return found
        ready = status & StatusBit.AMPLIFIER_READY or not host & AMPLIFIER_TOLD
        return 0 if ready and not status & StatusBit.EMERGENCY_STOP else NO_AUTHORITY

    def authorised(plan: Plan, sample: Sample, tick: int, elapsed: int) -> Plan:
        """`plan` after what the board says of the torque that was asked of it: while it is
        withheld nothing is rendered, and when it is granted again the gain begins at 0.
        """
        if plan.state in LATCHED and not sample[STATUS] & AUTHORITY:
            # what the board has taken does not come back with what is left of a fade
            return powerless(plan)._replace(unauthorised=0)
        if plan.state not in GRANTED or tick <= plan.since_tick:
            return plan._replace(unauthorised=0) if plan.unauthorised else plan
        if not sample[STATUS] & AUTHORITY:
            # a perturbation would come back at once with the authority
            if not plan.unauthorised:
                return withheld(plan, tick)
            count = plan.unauthorised + elapsed
            return plan._replace(unauthorised=count, gain=constant(0.0), wave=NO_WAVE)
        if not plan.unauthorised:
            return plan
        # the push of homing has no gain, and starts again by itself
        gain = gain_from(tick) if plan.state is State.ENABLED else plan.gain
        return plan._replace(unauthorised=0, gain=gain)

    def withheld(plan: Plan, tick: int) -> Plan:
        """`plan` from the tick on in which its force is withheld."""
        whole = plan.gain.end == 1.0 and not plan.gain.running(tick)
        since = tick if whole or plan.short_since < 0 else plan.short_since
        return plan._replace(unauthorised=1, gain=constant(0.0), wave=NO_WAVE, short_since=since)

    def unheard(plan: Plan, tick: int) -> Plan:
        """`plan` while no frame says whether the board still grants torque: an emergency stop may
        be pressed and released unseen, and what is sent would act at its release.
        """
        if plan.state in LATCHED:
            return powerless(plan)
        if plan.state is not State.ENABLED or plan.unauthorised:
            return plan
        return withheld(plan, tick)

    def gain_from(tick: int) -> Ramp:
        return Ramp(0.0, 1.0, tick, round_half_up(params.safety.enable_ramp_s * rate_hz))

    def given_up(plan: Plan, tick: int) -> bool:
        """Whether force that was withheld is so again, and has not been whole for too long."""
        short = plan.state is State.ENABLED and plan.unauthorised and plan.short_since >= 0
        return bool(short) and tick - plan.short_since > longest_short

    def newly_lost(plan: Plan, sample: Sample, tick: int) -> int:
        """Number of a fault that this sample brings, 0 for none; losses that matter only under
        force wait for force.
        """
        _, status, temperature, arrival, host, _, _, _, _ = sample
        if plan.state not in GRANTED:
            return cause(status, temperature, host)
        if not host & GATEWAY_ALIVE and params.safety.on_gateway_loss == "fault":
            return cause(status, temperature, host) or BY_CODE["gateway_lost"].number
        if arrival == SEED:
            return BY_CODE["board_restarted"].number
        if host & DEVICE_DIFFERS:
            return BY_CODE["device_differs"].number
        if len(plan.glitches) > params.safety.glitches_limit:
            return SENSOR_GLITCH
        if plan.unauthorised > params.safety.no_authority_limit:
            return cause_under_force(sample) or NO_AUTHORITY
        if given_up(plan, tick):
            return cause_under_force(sample) or (FRAMES_LOST if arrival < 0 else NO_AUTHORITY)
        return cause_under_force(sample)

    def overdue(plan: Plan, tick: int) -> bool:
        """Whether homing has searched longer than the device allows."""
        return plan.state is State.HOMING and tick - plan.since_tick > home.timeout_s * rate_hz

    def searched(plan: Plan, sample: Sample, now: Now) -> tuple[Plan, list[Answer]]:
        """`plan` after one sample of homing: still searching, disabled with the origin found, or
        at fault.
        """
        encoder, status, _, _, _, index_offset, _, current, _ = sample
        seen = Seen(
            now.tick,
            encoder,
            bool(status & StatusBit.ENABLED),
            encoder - index_offset if status & StatusBit.INDEX else None,
            params.device.current.to_value(current),
        )
        found = search.advance(plan.homing, seen)
        if isinstance(found, Failed):
            return obey(plan, fault_request(found.fault), now, params)
        if isinstance(found, Homing):
            return plan._replace(homing=found), []
        done = enter(plan, State.DISABLED, now, params, plan.actor)
        return with_origin(done, found.encoder - home_counts), []

    def alarming(plan: Plan, alarm: int) -> int:
        """The alarm of a monitor, if it is on and there is force that it could end."""
        watched = plan.limit_cycle_faults or alarm == OVERSPEED
        return alarm if watched and plan.state in GRANTED else 0

    def watched(plan: Plan, x: float, force_n: float, tick: int) -> Plan:
        """`plan` with its push followed, while the signs of the device are not verified."""
        if not params.device.commissioning or plan.state not in GRANTED:
            return plan
        return plan._replace(push=followed(plan.push, x, force_n, tick, params))

    def commanded(
        plan: Plan, commands: tuple[Request, ...], sample: Sample, now: Now, alarm: int
    ) -> tuple[Plan, tuple[Answer, ...]]:
        found = newly_lost(plan, sample, now.tick) or alarming(plan, alarm)
        found = found or push_ended(plan.push, now.tick, params)
        if not found and overdue(plan, now.tick):
            found = BY_CODE["home_failed"].number
        events: tuple[Request, ...] = (fault_request(found),) if found else ()
        answers: list[Answer] = []
        stops = tuple(one for one in commands if one[KIND] == Command.STOP)
        others = tuple(one for one in commands if one[KIND] != Command.STOP)
        for request in (*events, *others, *stops):
            plan, more = obey(plan, request, now, params)
            answers += more
        while plan.scheduled and plan.scheduled[0].tick <= now.tick:
            due = plan.scheduled[0]
            due = due._replace(tick=now.tick)  # its own slot may have been lost
            plan, more = apply_settings(plan._replace(scheduled=plan.scheduled[1:]), due, params)
            answers += more
        return plan, tuple(answers)

    def nothing_but_lost_frames(
        state: ServoState, commands: tuple[Any, ...], sample: Sample, tick: int
    ) -> bool:
        """The usual reason to be here while a busy host drops slots; the plan stays as it is,
        so the long way would be late too.
        """
        _, status, temperature, arrival, host, _, _, _, _ = sample
        settled = state[SETTLED]
        unasked = not commands and tick < settled.wake_tick and host == settled.host
        cool = low_count <= temperature <= high_count
        calm = unasked and status & settled.watched == settled.calm and cool
        return calm and 0 < arrival <= params.safety.missing_frames_limit

    def unwrapped(state: ServoState, encoder: int) -> ServoState:
        """`state` with its origin where the encoder's counter went round behind samples that were
        lost or doubted; behind one that came the tick itself sees it.
        """
        settled, law, ledger, held, signs = state
        plan = settled.plan
        turns = round((encoder - plan.origin - law[0] / m_per_count) / (1 << ENCODER_BITS))
        if not turns:
            return state
        ahead = turns << ENCODER_BITS
        doubted = tuple(count + ahead for count in plan.doubted)
        plan = plan._replace(origin=plan.origin + ahead, doubted=doubted)
        settled = replace(settled, origin=plan.origin, plan=plan)
        return settled, law, ledger, held, signs

    def undoubted(
        plan: Plan, law: LawState, encoder: int, arrival: int, tick: int
    ) -> tuple[Plan, tuple[float, ...], int]:
        """`plan` after a sample that follows doubted ones, the positions [m] that the law gets of
        those, and record flags.
        """
        *doubted, x = ((count - plan.origin) * m_per_count for count in (*plan.doubted, encoder))
        believing = plan._replace(doubted=())
        if arrival > params.safety.missing_frames_limit:
            return believing, (), 0
        if arrival:
            return believing, line(law[0], x, arrival + len(doubted)), int(Flag.INTERPOLATED)
        found = verdict(law, doubted, x, bend_m)
        if found is Verdict.OPEN:
            return plan, (), int(Flag.DOUBTED)
        if found is Verdict.MOVED:
            return believing, tuple(doubted), int(Flag.BELIEVED)
        recent = tuple(one for one in plan.glitches if tick - one < rate_hz)
        counted = believing._replace(glitches=(*recent, *len(doubted) * (tick,)))
        return counted, line(law[0], x, len(doubted)), int(Flag.GLITCH)

    def filled(
        plan: Plan, law: LawState, sample: Sample, tick: int
    ) -> tuple[Plan, tuple[float, ...], int]:
        """`plan` with a sample to be used, the positions [m] that the law gets of samples before it
        that were doubted or lost, and record flags.
        """
        encoder, _, _, arrival, _, _, _, _, _ = sample
        if plan.doubted:
            return undoubted(plan, law, encoder, arrival, tick)
        if not 0 < arrival <= params.safety.missing_frames_limit:
            return plan, (), 0
        positions = line(law[0], (encoder - plan.origin) * m_per_count, arrival)
        return plan, positions, int(Flag.INTERPOLATED)

    def believable(plan: Plan, law: LawState, encoder: int, arrival: int) -> bool:
        """Whether a sample came where those before it lead, over a gap of lost ones too."""
        x = (encoder - plan.origin) * m_per_count
        return 0 <= arrival < SEED and abs(x - law[0] - (arrival + 1) * law[1]) <= bend_m

    def located(plan: Plan, sample: Sample, usable: bool) -> Plan:
        """`plan` with the origin that is left of it."""
        _, status, _, arrival, _, _, _, _, _ = sample
        # another life of the board: its counter began anew, from wherever the device was
        if arrival == SEED:
            plan = without_origin(plan)._replace(origin=first_origin)
        if usable and status & StatusBit.ENCODER_FAULT:  # counts may have been missed
            plan = without_origin(plan)
        return plan

    def begins_anew(before: Plan, plan: Plan, arrival: int, tick: int) -> bool:
        """Whether the law is to start at rest: nothing is known of the motion before."""
        resetting = before.state in LATCHED and plan.state is State.DISABLED
        unwatched = plan.doubted and not out_flags(plan, tick) & OutFlag.ENABLE
        return (
            arrival > params.safety.missing_frames_limit
            or plan.origin != before.origin
            or resetting
            or bool(unwatched)
        )

    def begun_anew(before: Plan, plan: Plan, tick: int) -> tuple[Plan, int]:
        """`plan` of a law that starts at rest, and record flags."""
        plan = plan._replace(doubted=())
        if plan.state is State.ENABLED and before.state is State.ENABLED:
            return plan._replace(gain=gain_from(tick)), int(Flag.SEEDED | Flag.QUIET_RAMP)
        if plan.state in LATCHED:  # what faded is not rendered from a position that is new
            plan = powerless(plan)
        return plan, int(Flag.SEEDED)

    def attend(
        state: ServoState, commands: tuple[Any, ...], sample: Sample, tick: int
    ) -> tuple[ServoState, bool, tuple[Any, ...], int]:
        encoder, _, _, arrival, host, _, _, _, effect = sample
        if 0 < arrival < SEED or state[SETTLED].plan.doubted:
            state = unwrapped(state, encoder)
        settled, law, ledger, held, signs = state
        coefficients = settled.coefficients
        plan = silence.followed(settled.plan, settled.out_flags)
        before = plan
        # periods since the last tick, while something makes every tick come here; a look at the
        # winding whose own slot was lost says nothing of that
        looks = settled.wake_tick == plan.winding.due_tick
        elapsed = 1 if looks else max(1, tick - settled.wake_tick + 1)
        usable = arrival >= 0 and bool(host & LINK_UP) and encoder_counts(plan, tick)
        flags = 0
        if usable:
            plan, positions, flags = filled(plan, law, sample, tick)
            resistance = own_resistance + params.device.active_damping.to_value(effect) * rate_hz
            law, ledger = bridge(
                law, ledger, positions, settled.environment, coefficients, resistance, kept
            )
        if nothing_but_lost_frames(state, commands, sample, tick):
            return (settled, law, ledger, held, signs), True, (), flags | settled.flags
        plan = located(plan, sample, usable)
        _, held_n, former = held
        if usable:
            plan = authorised(plan, sample, tick, elapsed)
        elif -arrival >= UNHEARD:
            plan = unheard(plan, tick)
            ledger = unknown_before(ledger)  # what was booked is not what is sent now
        acting_n = 0.0 if plan.unauthorised else held_n
        gateway = bool(host & GATEWAY_ALIVE)
        last_tick = min(settled.wake_tick, tick) - 1
        cause_now = cause_against_force(sample)
        sure = usable and believable(plan, law, encoder, arrival)
        heard = -arrival < UNHEARD
        now = Now(tick, last_tick, encoder, acting_n, gateway, cause_now, bar(host), sure, heard)
        plan = watched(plan, law[0], acting_n, tick)
        plan, answers = commanded(plan, commands, sample, now, signs.alarm)
        usable = usable and encoder_counts(plan, tick)
        if plan.state is State.HOMING and usable and (sure or flags & RESOLVED):
            plan, more = searched(plan, sample, now)
            answers += tuple(more)
        if usable and begins_anew(before, plan, arrival, tick):
            law = at_rest((encoder - plan.origin) * m_per_count)
            ledger = unknown_before(ledger)
            plan, flags = begun_anew(before, plan, tick)
        plan = controlled(plan, ledger[EXCESS], (last_tick, tick), params, own)
        plan = advance_added(plan, tick, elapsed, params)
        plan = compensated(plan, sample, acting_n, tick, params)
        if plan.filters != before.filters:
            renewed = coefficients_of(plan, rate_hz)
            law = refiltered(law, coefficients, renewed)
            coefficients = renewed
        if plan.state is State.ENABLED or plan.state in LATCHED:
            x = (encoder - plan.origin) * m_per_count if usable else None
            plan, held_back = eased(plan, settled, x, law, coefficients, tick, params)
            flags |= held_back
        ready = flat_plan(plan, tick, params, params.soft_ends, limit_n)
        if plan.state is State.HOMING:
            ready = ready._replace(environment=pushing(plan.homing.force_n, homing_limit_n))
        if plan.silent_until > tick:
            flags |= int(Flag.WITHHELD)
        elif ready.wake_tick == tick + 1:
            flags |= int(Flag.RAMPING)
        if not usable and (plan.state not in GRANTED or plan.unauthorised):
            left = plan.fade.value(tick)
            held = (force.to_count(left, I16_LOWEST, I16_HIGHEST), left, former)
        settled = settle(plan, ready, coefficients, out_flags(plan, tick), host)
        flags |= settled.flags
        return (settled, law, ledger, held, CALM if signs.alarm else signs), usable, answers, flags

    return attend


def powerless(plan: Plan) -> Plan:
    """`plan` without what is left of its force: nothing of a fade comes back."""
    return plan._replace(gain=constant(0.0), fade=constant(0.0))


def encoder_counts(plan: Plan, tick: int) -> bool:
    """Whether the encoder has a say: not in how the force goes that its own lies have ended."""
    return plan.fault != SENSOR_GLITCH or not plan.fade.running(tick)


def bar(host: int) -> Result | None:
    """Why the board that `host` tells of may make no force; None if it may."""
    if host & DEVICE_DIFFERS:
        return Result.REFUSED_DEVICE
    return Result.REFUSED_RATE if host & RATE_NOT_HELD else None


def pushing(force_n: float, limit_n: float) -> LawInputs:
    """The law's numbers for a force alone."""
    numbers = 0.0, 0.0, 0.0, force_n, limit_n, 0.0, 0.0, 0.0, 0.0, -1e3, 1e3, 0.0
    return (*numbers, *(0.0 for _ in FURTHER))


def out_flags(plan: Plan, tick: int) -> int:
    """Flags of the OUT frame: torque authority only where the table grants torque."""
    if plan.silent_until:
        return silence.flags_of(plan, tick)
    live = plan.state in GRANTED or (
        plan.state in LATCHED and (plan.gain.running(tick) or plan.fade.running(tick))
    )
    flags = int(OutFlag.ENABLE) if live else 0
    return flags | int(OutFlag.PERTURB) if plan.wave[WAVE_COMMAND] else flags


def line(start: float, end: float, lost: int) -> tuple[float, ...]:
    """`lost` positions [m] on the straight line between `start` and `end`."""
    return tuple(start + (end - start) * index / (lost + 1) for index in range(1, lost + 1))


def bridge(
    law: LawState,
    ledger: Ledger,
    positions: Sequence[float],
    environment: LawInputs,
    coefficients: Coefficients,
    resistance: float,
    kept: float,
) -> tuple[LawState, Ledger]:
    """Feed the filters the `positions` [m] of samples without a tick of their own, while the last
    force was held.
    """
    for position in positions:
        _, _, v, _, spring, _, _, field, law = render(position, law, environment, coefficients)
        elastic = clamp(spring + field, environment[LIMIT])
        mass = environment[MASS]
        ledger = book(ledger, law[1], ledger[FORCE], 0.0, elastic, mass, v, resistance, kept)
    return law, ledger


def refiltered(law: LawState, old: Coefficients, new: Coefficients) -> LawState:
    """The law's state for new filters: steady at the velocity that the old ones would give next,
    without acceleration. What the old ones had still to forget does not come along.
    """
    x, d, vz1, _, _, _ = law
    (b0, *_), _ = split(old)
    velocity, _ = split(new)
    return (x, d, *steady(velocity, b0 * d + vz1), 0.0, 0.0)
