"""One tick as a function: (state, commands, sample, tick) -> (state, output). No clock, no mailbox,
no I/O.

The same call runs live, in lock-step and in a replay. Almost every tick takes the fast path:
position from the count, `render`, count from the force, ledger. A tick with a command, a running
ramp, a lost frame, a status bit or a missing heartbeat first takes `slow_path`, which makes a new
state; the fast path follows as usual.

`tick` is time: periods since the start, those of lost slots included, so it rises but may skip.
State is a short tuple (see `plan`). Its first item contains everything that changes rarely, so a
tick passes it on as one object. The force limit is the last step before the wire: the law clamps in
newtons, this module clamps the count once more.

The state must have no mutable values. No time or random number may be read here, and no float may
reach the wire.
"""

from collections.abc import Callable
from dataclasses import replace
from math import floor, inf, isfinite
from typing import Any

from hapticd.core.faults import BY_CODE
from hapticd.core.params import ServoParams
from hapticd.core.units import round_half_up
from hapticd.mailbox.layout import Flag
from hapticd.render.law import EMPTY, EXCESS, FORCE, MASS, at_rest, book, clamp, render
from hapticd.servo.energy import budget_j, lag
from hapticd.servo.plan import (
    LINK_UP,
    NEVER,
    Output,
    Sample,
    ServoState,
    coefficients_of,
    environment_of,
    fault_request,
    initial_plan,
    tick_constants,
)
from hapticd.servo.safety import CALM, ENERGY, at_limit, bounds, too_fast
from hapticd.servo.samples import MOST_DOUBTED, believed_bend_m, stuck_out
from hapticd.servo.slow_path import SlowPath
from hapticd.usb.codec import ENCODER_BITS, I16_HIGHEST, I16_LOWEST
from hapticd.usb.frames import OutFlag

__all__ = ["make_step"]

Step = Callable[[ServoState, tuple[Any, ...], Sample, int], tuple[ServoState, Output]]

_CLAMPED = int(Flag.CLAMPED)
_NOT_FINITE = int(Flag.NOT_FINITE)
_MISSING = int(Flag.MISSING_IN)
_RANGE = BY_CODE["sensor_range"].number
_FINITE = BY_CODE["not_finite"].number
_GLITCH = BY_CODE["sensor_glitch"].number
_DOUBTED = int(Flag.DOUBTED)
_SKIPPED = int(Flag.SEEDED | Flag.INTERPOLATED)  # the last sample is not the one before this
_JUDGED = int(Flag.GLITCH | Flag.BELIEVED)
_ENABLE = int(OutFlag.ENABLE)


def initial_state(params: ServoParams, tick: int = 0) -> ServoState:
    """Return the state disabled, at rest at count 0. The first sample of a link seeds the filters
    at the position of the device.
    """
    plan = initial_plan(params)._replace(origin=round_half_up(params.device.position.offset_count))
    coefficients = coefficients_of(plan, params.realtime.rate_hz)
    environment = environment_of(plan, tick, params.soft_ends, params.force_limit_n)
    count = params.device.force.to_count(0.0, I16_LOWEST, I16_HIGHEST)
    held = (count, 0.0, (at_rest(0.0), EMPTY))
    settled = tick_constants(plan, tick, params, environment, coefficients, 0, LINK_UP)
    return settled, at_rest(0.0), EMPTY, held, CALM


def with_more(output: Output, flags: int, answers: tuple[Any, ...]) -> Output:
    """Return `output` with the findings of the tick before it was repeated."""
    torque, x, v, a, spring, damper, inertia, field, applied, later_flags, later = output
    parts = (torque, x, v, a, spring, damper, inertia, field, applied)
    return (*parts, flags | later_flags, answers + later)


def make_step(params: ServoParams) -> Step:
    """Return the step function for one device."""
    slow_path = SlowPath(params).tick
    rate_hz = params.realtime.rate_hz
    force = params.device.force
    m_per_count = params.device.position.per_count * params.device.position.sign
    counts_per_n = force.sign / force.per_count
    zero_count = force.offset_count
    n_per_count = force.sign * force.per_count
    rounding = zero_count + 0.5
    limit_n = params.force_limit_n
    ends = sorted(
        (
            force.to_count(limit_n, I16_LOWEST, I16_HIGHEST),
            force.to_count(-limit_n, I16_LOWEST, I16_HIGHEST),
        )
    )
    low, high = ends
    turn_m = m_per_count * (1 << ENCODER_BITS)
    jump_m = params.device.speed_limit_m_per_s / rate_hz
    bound = bounds(params)
    fast_m = min(bound.fast_m, jump_m)
    slow_m = -fast_m
    own_resistance = bound.resistance
    resistance_per_count = (
        params.device.active_damping.to_value(1.0) - params.device.active_damping.to_value(0.0)
    ) * rate_hz
    resistance_at_0 = own_resistance + params.device.active_damping.to_value(0.0) * rate_hz
    kept = bound.kept
    most_j = bound.energy_j
    look_j = min(most_j, budget_j(params))
    found = lag(params)
    lags = found is not None
    behind, newest, last = found or (0.0, 1.0, 0.0)
    most_bend_m = believed_bend_m(params)
    least_bend_m = -most_bend_m
    least_heat, most_heat = params.device.temperature_counts(I16_LOWEST, I16_HIGHEST)

    def missing(
        state: ServoState, flags: int, answers: tuple[Any, ...]
    ) -> tuple[ServoState, Output]:
        """Repeat the last output, without a valid sample (0 once the torque is off)."""
        _, (x, *_), _, (torque, applied, _), _ = state
        nothing = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # velocity, acceleration, parts of the force
        return state, (torque, x, *nothing, applied, flags | _MISSING, answers)

    def faulted(
        state: ServoState,
        sample: Sample,
        tick: int,
        fault: int,
        flags: int,
        answers: tuple[Any, ...],
    ) -> tuple[ServoState, Output]:
        encoder, status, temperature, _, host, index, delay, current, damping = sample
        unusable = (encoder, status, temperature, -1, host, index, delay, current, damping)
        state, _, more, more_flags = slow_path(state, (fault_request(fault),), unusable, tick)
        return missing(state, flags | more_flags, answers + more)

    def turned(
        state: ServoState,
        sample: Sample,
        tick: int,
        turns: int,
        flags: int,
        answers: tuple[Any, ...],
    ) -> tuple[ServoState, Output]:
        """Shift the origin after a wrap of the encoder's counter, and judge the sample again."""
        settled, law, ledger, held, signs = state
        origin = settled.origin + (turns << ENCODER_BITS)
        settled = replace(settled, origin=origin, plan=settled.plan._replace(origin=origin))
        encoder, _, temperature, _, host, _, delay, current, damping = sample
        again = (encoder, settled.calm, temperature, 0, host, 0, delay, current, damping)
        state, output = step((settled, law, ledger, held, signs), (), again, tick)
        return state, with_more(output, flags, answers)

    def surprised(
        state: ServoState, sample: Sample, tick: int, flags: int, answers: tuple[Any, ...]
    ) -> tuple[ServoState, Output]:
        """Handle a sample that bends the motion. It is doubted, unless the sample before it was a
        glitch too small to be doubted. Then the tick is repeated from before that one.
        """
        settled, law, _, held, signs = state
        _, _, (before, booked) = held
        x = m_per_count * (sample[0] - settled.origin)
        if flags & _SKIPPED or not stuck_out(before, law, x, most_bend_m):
            return doubtful(state, sample, tick, flags, answers)
        last = settled.origin + round(law[0] / m_per_count)
        settled = replace(settled, plan=settled.plan._replace(doubted=(last,)), wake_tick=tick)
        state, output = step((settled, before, booked, held, signs), (), sample, tick)
        return state, with_more(output, flags, answers)

    def doubtful(
        state: ServoState, sample: Sample, tick: int, flags: int, answers: tuple[Any, ...]
    ) -> tuple[ServoState, Output]:
        """Handle a doubted sample: the force is that of the straight continuation, and the law
        stays as it was (`servo.samples`).
        """
        settled, law, ledger, held, signs = state
        encoder, _, _, _, host, _, *others = sample
        doubted = (*settled.plan.doubted, encoder)
        if len(doubted) - doubted.count(None) > MOST_DOUBTED:
            return faulted(state, sample, tick, _GLITCH, flags, answers)
        start, moved, *_ = law
        ahead = law
        for steps in range(1, len(doubted)):
            *_, ahead = render(
                start + steps * moved, ahead, settled.environment, settled.coefficients
            )
        count = settled.origin + round((start + len(doubted) * moved) / m_per_count)
        straight: Any = (count, settled.calm, least_heat, 0, host, 0, *others)
        undisturbed = (replace(settled, wake_tick=NEVER), ahead, ledger, held, signs)
        (*_, (torque, applied, _), signs), output = step(undisturbed, (), straight, tick)
        plan = settled.plan._replace(doubted=doubted)
        settled = replace(settled, plan=plan, wake_tick=tick + 1)
        state = (settled, law, ledger, (torque, applied, held[2]), signs)
        return state, with_more(output, flags | _DOUBTED, answers)

    def step(
        state: ServoState, commands: tuple[Any, ...], sample: Sample, tick: int
    ) -> tuple[ServoState, Output]:
        encoder, status, temperature, arrival, host, _, delay, _, damping = sample
        answers: tuple[Any, ...] = ()
        settled, law, ledger, held, signs = state
        flags = settled.flags
        if (
            commands
            or arrival
            or tick >= settled.wake_tick
            or host != settled.host
            or status & settled.watched != settled.calm
            or temperature > most_heat
            or temperature < least_heat
        ):
            state, usable, answers, flags = slow_path(state, commands, sample, tick)
            if not usable:
                return missing(state, flags, answers)
            if flags & _DOUBTED:
                return doubtful(state, sample, tick, flags, answers)
            settled, law, ledger, held, signs = state
        x = m_per_count * (encoder - settled.origin)
        environment = settled.environment
        newtons, total, v, a, spring, damper, inertia, field, after = render(
            x, law, environment, settled.coefficients
        )
        if settled.proxy_n:  # part of the bias
            spring += settled.proxy_n
        moved_m = after[1]
        bend_m = moved_m - law[1]
        # no chained comparison: CPython compares two floats faster alone
        if not (moved_m <= fast_m and moved_m >= slow_m):
            if turns := round(moved_m / turn_m):
                return turned(state, sample, tick, turns, flags, answers)
            if abs(moved_m) > jump_m:
                return faulted(state, sample, tick, _RANGE, flags, answers)
            signs = too_fast(signs, tick, bound.fast_ticks)
        if (
            not (bend_m <= most_bend_m and bend_m >= least_bend_m)
            and settled.out_flags & _ENABLE
            and not flags & _JUDGED
        ):
            return surprised(state, sample, tick, flags, answers)
        elastic = spring + field
        if newtons != total:
            flags |= _CLAMPED
            if not isfinite(total):
                return faulted(
                    (settled, at_rest(x), ledger, held, signs),
                    sample,
                    tick,
                    _FINITE,
                    flags | _NOT_FINITE,
                    answers,
                )
            signs = at_limit(signs, newtons, tick, bound.window_ticks)
            elastic = clamp(elastic, abs(newtons))
        torque = floor(newtons * counts_per_n + rounding)
        if torque < low or torque > high:
            torque = low if torque < low else high
        applied = n_per_count * (torque - zero_count)
        in_effect = applied
        if lags:
            _, last_n, _ = held
            in_effect = behind * ledger[FORCE] + newest * applied + last * last_n
        booked = book(
            ledger,
            moved_m,
            in_effect,
            delay if delay > 0.0 else 0.0,
            elastic,
            environment[MASS],
            v,
            resistance_at_0 + resistance_per_count * damping,
            kept,
        )
        if not booked[EXCESS] <= look_j:  # also true of NaN
            settled = replace(settled, wake_tick=tick + 1)
            if most_j < inf and not booked[EXCESS] <= most_j:
                signs = signs.raised(ENERGY)
        if signs is not CALM and signs.alarm:  # a named tuple's field is slow to reach
            settled = replace(settled, wake_tick=tick + 1)
        state = (settled, after, booked, (torque, applied, (law, ledger)), signs)
        return state, (torque, x, v, a, spring, damper, inertia, field, applied, flags, answers)

    return step
