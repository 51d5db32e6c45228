"""The slow path of a tick: lost frames, causes of faults, commands, ramps, homing.

Causes (`Causes`). The fault of a sample, as its number (`core.faults`), 0 for none. Three methods
check causes, each with more of them than the one before: `present` in any state, `under_force`
while there is force, and `against_force` before enabling. `newly_lost` is the fault that a sample
adds to a plan.

Order (`SlowPath`). A tick ends in a state for the fast path. Order within it: arrivals (`samples`)
-> faults -> commands -> scheduled changes -> homing -> active damping and ramps. So a stop that
arrives with an enable wins, and a reset sees a fault that appears in this tick. The fast path looks
only at `TickConstants`, so each change of the plan has to update it.
"""

from typing import Any

from hapticd.core.environment import FURTHER
from hapticd.core.faults import BY_CODE
from hapticd.core.params import ServoParams
from hapticd.core.units import round_half_up
from hapticd.mailbox.layout import Command, Flag, Result
from hapticd.render.law import (
    EXCESS,
    STIFFNESS,
    Coefficients,
    LawInputs,
    LawState,
    Ramp,
    at_rest,
    constant,
    split,
    steady,
)
from hapticd.render.law import ledger_at_rest as unknown_before
from hapticd.servo import watchdog_trial
from hapticd.servo.commands import CommandContext, apply_settings, enter, obey
from hapticd.servo.compensation import compensated
from hapticd.servo.energy import controlled, eased
from hapticd.servo.homing import Failed, Homing, HomingSample, HomingSearch, force_limit_n
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
    added_target,
    advance_added,
    coefficients_of,
    environment_of,
    fault_request,
    tick_constants,
    wake_tick,
    with_origin,
)
from hapticd.servo.proxy import moved
from hapticd.servo.safety import (
    CALM,
    GRANTED,
    LATCHED,
    OVERSPEED,
    State,
    bounds,
    followed,
    push_ended,
)
from hapticd.servo.samples import MOST_DOUBTED, Samples
from hapticd.usb.codec import I16_HIGHEST, I16_LOWEST
from hapticd.usb.device import SEED
from hapticd.usb.frames import OutFlag, StatusBit

__all__ = ["refiltered"]

# --- causes of faults -----------------------------------------------------------------------------

NO_AUTHORITY = BY_CODE["no_authority"].number
FRAMES_LOST = BY_CODE["frames_lost"].number
SENSOR_GLITCH = BY_CODE["sensor_glitch"].number
SHORT_S = 1.0  # in addition to the ramp of enabling: limit for force that is withheld again


class Causes:
    """The causes of faults, with the limits of `params`."""

    def __init__(self, params: ServoParams) -> None:
        self._params = params
        self._low_count, self._high_count = params.device.temperature_counts(
            I16_LOWEST, I16_HIGHEST
        )
        longest_s = params.safety.enable_ramp_s + SHORT_S
        self._longest_short = round_half_up(longest_s * params.realtime.rate_hz)

    def cool(self, temperature: int) -> bool:
        """Return whether the count of the winding's temperature is inside its limits."""
        return self._low_count <= temperature <= self._high_count

    def present(self, status: int, temperature: int, host: int) -> int:
        """Return the number of a fault that is present, 0 for none."""
        if not host & LINK_UP:
            return BY_CODE["usb_lost"].number
        if status & BOARD_FAULT:
            return BY_CODE["board_fault"].number
        allowed = self.cool(temperature) or host & NO_TEMPERATURE
        if status & StatusBit.OVER_TEMPERATURE or not allowed:
            return BY_CODE["over_temperature"].number
        return 0

    def under_force(self, sample: Sample) -> int:
        """Return a fault as `present`, or one that matters only under force. It prevents an enable
        and a reset.
        """
        _, status, temperature, arrival, host, _, _, _, _ = sample
        if found := self.present(status, temperature, host):
            return found
        if status & StatusBit.WATCHDOG:
            return BY_CODE["board_watchdog"].number
        return FRAMES_LOST if -arrival > self._params.safety.missing_frames_limit else 0

    def against_force(self, sample: Sample) -> int:
        """Return a fault as `under_force`, or a condition that may pass within a few ticks under
        force (contacts bounce). It prevents an enable and a reset too.
        """
        _, status, _, _, host, _, _, _, _ = sample
        if found := self.under_force(sample):
            return found
        ready = status & StatusBit.AMPLIFIER_READY or not host & AMPLIFIER_TOLD
        return 0 if ready and not status & StatusBit.EMERGENCY_STOP else NO_AUTHORITY

    def newly_lost(self, plan: Plan, sample: Sample, tick: int) -> int:
        """Return the number of a fault that this sample causes, 0 for none. Losses that matter only
        under force count only under force.
        """
        _, status, temperature, arrival, host, _, _, _, _ = sample
        if plan.state not in GRANTED:
            return self.present(status, temperature, host)
        if not host & GATEWAY_ALIVE and self._params.safety.on_gateway_loss == "fault":
            return self.present(status, temperature, host) or BY_CODE["gateway_lost"].number
        if arrival == SEED:
            return BY_CODE["board_restarted"].number
        if host & DEVICE_DIFFERS:
            return BY_CODE["device_differs"].number
        if len(plan.glitches) > self._params.safety.glitches_limit:
            return SENSOR_GLITCH
        if plan.unauthorised > self._params.safety.no_authority_limit:
            return self.under_force(sample) or NO_AUTHORITY
        if self._given_up(plan, tick):
            return self.under_force(sample) or (FRAMES_LOST if arrival < 0 else NO_AUTHORITY)
        return self.under_force(sample)

    def _given_up(self, plan: Plan, tick: int) -> bool:
        """Return whether force is withheld again without having been complete for too long."""
        short = plan.state is State.ENABLED and plan.unauthorised and plan.short_since >= 0
        return bool(short) and tick - plan.short_since > self._longest_short


# --- order within a tick --------------------------------------------------------------------------

RESOLVED = int(Flag.GLITCH | Flag.BELIEVED)  # of an accepted sample
UNHEARD = 3  # consecutive ticks without a frame: torque counts as not granted (ADR-0011)


class SlowPath:
    """The slow path for the device of `params`; without a state of its own."""

    def __init__(self, params: ServoParams) -> None:
        position = params.device.position
        self._params = params
        self._rate_hz = params.realtime.rate_hz
        self._causes = Causes(params)
        self._samples = Samples(params)
        self._own = bounds(params)
        self._home = params.device.home
        self._home_counts = round_half_up(
            position.sign * self._home.position_m / position.per_count
        )
        self._search = HomingSearch(params)
        self._homing_limit_n = force_limit_n(params)

    def tick(
        self, state: ServoState, commands: tuple[Any, ...], sample: Sample, tick: int
    ) -> tuple[ServoState, bool, tuple[Any, ...], int]:
        """Return the state for the fast path, whether the sample is usable, answers, and record
        flags.
        """
        encoder, _, _, arrival, host, _, _, _, effect = sample
        if 0 < arrival < SEED or state[SETTLED].plan.doubted:
            state = self._samples.unwrapped(state, encoder)
        settled, former_law, ledger, held, signs = state
        law = former_law
        coefficients = settled.coefficients
        plan = watchdog_trial.followed(settled.plan, settled.out_flags)
        before = plan
        # periods since the last tick, if every tick takes the slow path
        elapsed = max(1, tick - settled.wake_tick + 1)
        usable = arrival >= 0 and bool(host & LINK_UP) and encoder_counts(plan, tick)
        flags = 0
        if usable:
            plan, positions, flags = self._samples.filled(plan, law, sample, tick)
            law, ledger = self._samples.bridged(law, ledger, positions, settled, effect)
        if not plan.doubted and self._nothing_but_lost_frames(state, commands, sample, tick):
            return (settled, law, ledger, held, signs), True, (), flags | settled.flags
        plan = self._samples.located(plan, sample, usable)
        _, held_n, former = held
        if usable:
            plan = self._authorised(plan, sample, tick, elapsed)
        elif -arrival >= UNHEARD:
            plan = self._unheard(plan, tick)
            ledger = unknown_before(ledger)  # the booked force is no longer the sent one
        acting_n = 0.0 if plan.unauthorised else held_n
        gateway = bool(host & GATEWAY_ALIVE)
        last_tick = min(settled.wake_tick, tick) - 1
        cause_now = self._causes.against_force(sample)
        sure = usable and self._samples.believable(before, former_law, encoder, arrival)
        heard = -arrival < UNHEARD
        now = CommandContext(
            tick, last_tick, encoder, acting_n, gateway, cause_now, bar(host), sure, heard
        )
        plan = self._watched(plan, law[0], acting_n, tick)
        plan, answers = self._commanded(plan, commands, sample, now, signs.alarm)
        usable = usable and encoder_counts(plan, tick)
        trusted = usable and bool(sure or flags & RESOLVED)
        if plan.state is State.HOMING and trusted:
            plan, more = self._searched(plan, sample, now)
            answers += tuple(more)
        if usable and self._begins_anew(before, plan, arrival, tick):
            law = at_rest(self._samples.position_m(plan, encoder))
            ledger = unknown_before(ledger)
            plan, flags = self._begun_anew(before, plan, tick)
        plan = controlled(plan, ledger[EXCESS], (last_tick, tick), self._params, self._own)
        # damping that begins to change in this tick, or turns back, does not cover lost slots
        aim = added_target(before, tick, self._params)
        goes_on = before.added != aim == added_target(plan, tick, self._params)
        plan = advance_added(plan, tick, elapsed if goes_on else 1, self._params)
        plan = compensated(plan, sample, acting_n, tick, self._params)
        if plan.filters != before.filters:
            renewed = coefficients_of(plan, self._rate_hz)
            law = refiltered(law, coefficients, renewed)
            coefficients = renewed
        x = self._samples.position_m(plan, encoder) if trusted else None
        stepped_n = 0.0
        if plan.state is State.ENABLED or plan.state in LATCHED:
            plan, held_back, stepped_n = eased(
                plan, settled, x, law, coefficients, tick, self._params
            )
            flags |= held_back
        if plan.proxy.owner:
            plan = moved(plan, x, tick, self._params, settled.environment[STIFFNESS], stepped_n)
        if not usable and (plan.state not in GRANTED or plan.unauthorised):
            held = (*self._fading(plan, tick), former)
        environment = self._environment(plan, tick)
        sent_flags = out_flags(plan, tick)
        settled = tick_constants(
            plan, tick, self._params, environment, coefficients, sent_flags, host
        )
        # a moving proxy is not a ramp
        wake = wake_tick(plan, tick, self._params) if plan.proxy.owner else settled.wake_tick
        flags |= settled.flags | _pending_flags(plan, wake, tick)
        return (settled, law, ledger, held, CALM if signs.alarm else signs), usable, answers, flags

    def _environment(self, plan: Plan, tick: int) -> LawInputs:
        """Return the inputs of the law for `plan`; during homing only its push."""
        if plan.state is State.HOMING:
            numbers = 0.0, 0.0, 0.0, plan.homing.force_n, self._homing_limit_n
            nothing = 0.0, 0.0, 0.0, 0.0, -1e3, 1e3, 0.0  # no wall, and the ends out of reach
            return (*numbers, *nothing, *(0.0 for _ in FURTHER))
        return environment_of(plan, tick, self._params.soft_ends, self._params.force_limit_n)

    def _fading(self, plan: Plan, tick: int) -> tuple[int, float]:
        """Return torque count and force [N] of the remaining fade, without a valid sample."""
        left = plan.fade.value(tick)
        return self._params.device.force.to_count(left, I16_LOWEST, I16_HIGHEST), left

    def _authorised(self, plan: Plan, sample: Sample, tick: int, elapsed: int) -> Plan:
        """Return `plan` after the board's report about the requested torque. While torque is
        withheld nothing is rendered; when it is granted again, the gain starts at 0.
        """
        if plan.state in LATCHED and not sample[STATUS] & AUTHORITY:
            # force withdrawn by the board does not return with the rest of a fade
            return powerless(plan)._replace(unauthorised=0)
        if plan.state not in GRANTED or tick <= plan.since_tick:
            return plan._replace(unauthorised=0) if plan.unauthorised else plan
        if not sample[STATUS] & AUTHORITY:
            # a perturbation would return at once with the authority
            if not plan.unauthorised:
                return self._withheld(plan, tick)
            count = plan.unauthorised + elapsed
            return plan._replace(unauthorised=count, gain=constant(0.0), wave=NO_WAVE)
        if not plan.unauthorised:
            return plan
        # the push of homing has no gain, and starts again by itself
        gain = self._gain_from(tick) if plan.state is State.ENABLED else plan.gain
        return plan._replace(unauthorised=0, gain=gain)

    def _withheld(self, plan: Plan, tick: int) -> Plan:
        whole = plan.gain.end == 1.0 and not plan.gain.running(tick)
        since = tick if whole or plan.short_since < 0 else plan.short_since
        return plan._replace(unauthorised=1, gain=constant(0.0), wave=NO_WAVE, short_since=since)

    def _unheard(self, plan: Plan, tick: int) -> Plan:
        """Return `plan` while no frame shows whether the board still grants torque. An emergency
        stop may be pressed and released unseen, and the sent force would act at its release.
        """
        if plan.state in LATCHED:
            return powerless(plan)
        if plan.state is not State.ENABLED or plan.unauthorised:
            return plan
        return self._withheld(plan, tick)

    def _gain_from(self, tick: int) -> Ramp:
        return Ramp(
            0.0, 1.0, tick, round_half_up(self._params.safety.enable_ramp_s * self._rate_hz)
        )

    def _searched(
        self, plan: Plan, sample: Sample, now: CommandContext
    ) -> tuple[Plan, list[Answer]]:
        """Return `plan` after one sample of homing: still searching, disabled with the origin
        found, or at fault.
        """
        encoder, status, _, _, _, index_offset, _, current, _ = sample
        seen = HomingSample(
            now.tick,
            encoder,
            bool(status & StatusBit.ENABLED),
            encoder - index_offset if status & StatusBit.INDEX else None,
            self._params.device.current.to_value(current),
        )
        found = self._search.advance(plan.homing, seen)
        if isinstance(found, Failed):
            return obey(plan, fault_request(found.fault), now, self._params)
        if isinstance(found, Homing):
            return plan._replace(homing=found), []
        done = enter(plan, State.DISABLED, now, self._params, plan.actor)
        return with_origin(done, found.encoder - self._home_counts), []

    def _alarming(self, plan: Plan, alarm: int) -> int:
        watched = plan.limit_cycle_faults or alarm == OVERSPEED
        return alarm if watched and plan.state in GRANTED else 0

    def _watched(self, plan: Plan, x: float, force_n: float, tick: int) -> Plan:
        """Return `plan` with its push followed, while the signs of the device are not verified."""
        if not self._params.device.commissioning or plan.state not in GRANTED:
            return plan
        return plan._replace(push=followed(plan.push, x, force_n, tick, self._params))

    def _commanded(
        self,
        plan: Plan,
        commands: tuple[Request, ...],
        sample: Sample,
        now: CommandContext,
        alarm: int,
    ) -> tuple[Plan, tuple[Answer, ...]]:
        found = self._causes.newly_lost(plan, sample, now.tick) or self._alarming(plan, alarm)
        found = found or push_ended(plan.push, now.tick, self._params)
        longest = self._home.timeout_s * self._rate_hz
        if not found and plan.state is State.HOMING and now.tick - plan.since_tick > longest:
            found = BY_CODE["home_failed"].number
        events: tuple[Request, ...] = (fault_request(found),) if found else ()
        answers: list[Answer] = []
        stops = tuple(one for one in commands if one[KIND] == Command.STOP)
        others = tuple(one for one in commands if one[KIND] != Command.STOP)
        for request in (*events, *others, *stops):
            plan, more = obey(plan, request, now, self._params)
            answers += more
        while plan.scheduled and plan.scheduled[0].tick <= now.tick:
            due = plan.scheduled[0]
            due = due._replace(tick=now.tick)  # its own slot may have been lost
            plan, more = apply_settings(
                plan._replace(scheduled=plan.scheduled[1:]), due, self._params
            )
            answers += more
        return plan, tuple(answers)

    def _nothing_but_lost_frames(
        self, state: ServoState, commands: tuple[Any, ...], sample: Sample, tick: int
    ) -> bool:
        """Return whether a lost frame is the only reason for the slow path. This is usual while a
        busy host drops slots. The plan stays as it is, because the slow path would be late too.
        """
        _, status, temperature, arrival, host, _, _, _, _ = sample
        settled = state[SETTLED]
        unasked = not commands and tick < settled.wake_tick and host == settled.host
        cool = self._causes.cool(temperature)
        calm = unasked and status & settled.watched == settled.calm and cool
        return calm and 0 < arrival <= self._params.safety.missing_frames_limit

    def _begins_anew(self, before: Plan, plan: Plan, arrival: int, tick: int) -> bool:
        """Return whether the law must start at rest, because the motion before is unknown."""
        resetting = before.state in LATCHED and plan.state is State.DISABLED
        unwatched = plan.doubted and not out_flags(plan, tick) & OutFlag.ENABLE
        most = self._params.safety.missing_frames_limit
        return (
            arrival > most
            or plan.doubted.count(None) > most + MOST_DOUBTED
            or plan.origin != before.origin
            or resetting
            or bool(unwatched)
        )

    def _begun_anew(self, before: Plan, plan: Plan, tick: int) -> tuple[Plan, int]:
        """Return `plan` with a law that starts at rest, and record flags."""
        plan = plan._replace(doubted=())
        if plan.state is State.ENABLED and before.state is State.ENABLED:
            return plan._replace(gain=self._gain_from(tick)), int(Flag.SEEDED | Flag.QUIET_RAMP)
        if plan.state in LATCHED:  # a fading law must not act from a new position
            plan = powerless(plan)
        return plan, int(Flag.SEEDED)


def _pending_flags(plan: Plan, wake_tick: int, tick: int) -> int:
    """Return record flags of a plan that changes with the next tick, or waits for the end of a
    silence.
    """
    if plan.silent_until > tick:
        return int(Flag.WITHHELD)
    return int(Flag.RAMPING) if wake_tick == tick + 1 else 0


def powerless(plan: Plan) -> Plan:
    """Return `plan` without remaining force: no fade continues."""
    return plan._replace(gain=constant(0.0), fade=constant(0.0))


def encoder_counts(plan: Plan, tick: int) -> bool:
    """Return whether the encoder is used: not for the fade of a force that its own glitch has
    ended.
    """
    return plan.fault != SENSOR_GLITCH or not plan.fade.running(tick)


def bar(host: int) -> Result | None:
    """Return why the board with flags `host` may make no force; None if it may."""
    if host & DEVICE_DIFFERS:
        return Result.REFUSED_DEVICE
    return Result.REFUSED_RATE if host & RATE_NOT_HELD else None


def out_flags(plan: Plan, tick: int) -> int:
    """Return the flags of the OUT frame: torque authority only where the table grants torque."""
    if plan.silent_until:
        return watchdog_trial.flags_of(plan, tick)
    live = plan.state in GRANTED or (
        plan.state in LATCHED and (plan.gain.running(tick) or plan.fade.running(tick))
    )
    flags = int(OutFlag.ENABLE) if live else 0
    return flags | int(OutFlag.PERTURB) if plan.wave[WAVE_COMMAND] else flags


def refiltered(law: LawState, old: Coefficients, new: Coefficients) -> LawState:
    """Return the law's state for new filters. It is steady at the velocity that the old filters
    would give next, without acceleration. Transients of the old filters are dropped.
    """
    x, d, vz1, _, _, _ = law
    (b0, *_), _ = split(old)
    velocity, _ = split(new)
    return (x, d, *steady(velocity, b0 * d + vz1), 0.0, 0.0)
