"""The limit on parameter changes in one tick: the force steps no further than the device file
allows.

    |F(x, v, a; parameters of this tick) - F(x, v, a; those of the last)| <= limits.force_step_n

Both are the law at the sample of this tick. The limit therefore applies to the step of an enable or
of a change of parameters, and not to an impact on a stiff wall. If that step is too large, all
ramping values, the gain included, move by a share of it and continue in the next tick. A ramp then
ends later than requested, and records show the values in force. A change that removes the whole
force (disable, stop, fault, the ramp from 0 after a gap) is not held back. Without a sample the
force is held, and during a stop or fault the acting force ramps down. In both cases the parameters
wait.

The energy of such a step is booked. If the bookings of the last second exceed the budget, the step
is computed again with changes of decreasing values only (`servo.ramp_energy`).

The force is continuous in the share, but neither monotonic nor linear (clamp, walls, gain times
value), so bisection finds the share. A step lies between half the bound and the bound, and any
change completes.

The force must be a continuous function of its parameters, and parameters must change on a ramp.
"""

from math import inf, isfinite
from typing import NamedTuple

from hapticd.core.params import ServoParams
from hapticd.mailbox.layout import Flag
from hapticd.render.law import Coefficients, LawInputs, LawState, render
from hapticd.render.ramp import Ramp
from hapticd.servo import ramp_energy
from hapticd.servo.plan import Plan, TickConstants, environment_of
from hapticd.servo.safety import LATCHED, State

HALVINGS = 40  # of the step of one tick: from the whole range of a value to an imperceptible step


class RateLimited(NamedTuple):
    """A plan whose parameters moved as far as allowed in this tick."""

    plan: Plan
    flags: int  # of the record: EASED, PAUSED


class Step(NamedTuple):
    """A step of the parameters, and the resulting environment."""

    plan: Plan
    environment: LawInputs


class StepContext(NamedTuple):
    """The conditions for a step of the parameters in this tick."""

    x: float  # m
    v: float  # m/s, as the law has it
    force_n: float  # with the parameters of the last tick
    law: LawState
    environment: LawInputs  # in force in the last tick
    coefficients: Coefficients
    tick: int
    last_tick: int


def eased(
    plan: Plan,
    settled: TickConstants,
    x: float | None,
    law: LawState,
    coefficients: Coefficients,
    tick: int,
    params: ServoParams,
) -> RateLimited:
    """Return `plan` with its parameters at `tick` as far as the force step and the energy of ramps
    allow.

    `settled` belongs to the tick before; `law` and `coefficients` apply at this tick's position `x`
    [m]. None: there is no sample, and the force is held.
    """
    before = settled.plan
    last_tick = settled.wake_tick - 1  # during a ramp; otherwise any tick gives the same values
    if plan.state in LATCHED:
        fading = plan.gain.value(tick) > 0.0 and isfinite(params.device.force_step_n)
        held = on_the_way(plan, before, last_tick, tick, 0.0) if fading else plan
        return with_flag(plan, held)
    if plan.state is not State.ENABLED or plan.gain.value(tick) < before.gain.value(last_tick):
        return RateLimited(plan, 0)
    if x is None:
        return with_flag(plan, on_the_way(plan, before, last_tick, tick, 0.0))
    was = settled.environment
    force_n, _, v, *_ = render(x, law, was, coefficients)
    here = StepContext(x, v, force_n, law, was, coefficients, tick, last_tick)
    step = stepped(plan, before, here, params)
    if params.device.ramp_energy_j == inf or step.environment == was:
        return with_flag(plan, step.plan)
    return budgeted(plan, before, step, here, params)


def with_flag(plan: Plan, slower: Plan) -> RateLimited:
    """Return `slower` with its flag; `slower` is `plan` itself if nothing was held back."""
    return RateLimited(slower, 0 if slower is plan else int(Flag.EASED))


def stepped(plan: Plan, before: Plan, here: StepContext, params: ServoParams) -> Step:
    """Return `plan` advanced as far as the force step allows."""
    bound_n = params.device.force_step_n
    limit_n = params.force_limit_n
    workspace = params.soft_ends
    share = 1.0
    candidate = plan
    for _ in range(HALVINGS):
        environment = environment_of(candidate, here.tick, workspace, limit_n)
        force_n, *_ = render(here.x, here.law, environment, here.coefficients)
        if not abs(force_n - here.force_n) > bound_n:
            return Step(candidate, environment)
        share *= 0.5
        candidate = on_the_way(plan, before, here.last_tick, here.tick, share)
    return Step(on_the_way(plan, before, here.last_tick, here.tick, 0.0), here.environment)


def budgeted(
    plan: Plan, before: Plan, step: Step, here: StepContext, params: ServoParams
) -> RateLimited:
    """Return `step` with its energy booked. If that would exceed the budget, only decreasing values
    of `plan` move.
    """
    rate_hz = params.realtime.rate_hz
    budget_j = params.device.ramp_energy_j
    was = ramp_energy.stored(here.environment, here.x, here.v)
    now = ramp_energy.stored(step.environment, here.x, here.v)
    energy_j = ramp_energy.added(was, now)
    _, flags = with_flag(plan, step.plan)
    if ramp_energy.too_much(plan, energy_j, here.tick, rate_hz, budget_j):
        wall_gains = now[ramp_energy.WALL] > was[ramp_energy.WALL]
        waiting = ramp_energy.paused(plan, before, here.last_tick, here.tick, wall_gains)
        step = stepped(waiting, before, here, params)
        flags = with_flag(waiting, step.plan).flags | int(Flag.PAUSED)
        energy_j = ramp_energy.added(was, ramp_energy.stored(step.environment, here.x, here.v))
    if not energy_j > 0.0:
        return RateLimited(step.plan, flags)
    return RateLimited(ramp_energy.booked(step.plan, energy_j, here.tick, rate_hz), flags)


def on_the_way(plan: Plan, before: Plan, last_tick: int, tick: int, share: float) -> Plan:
    """Return `plan` with every parameter at `tick` only `share` of the way from its value in
    `before` at `last_tick`, and on its ramp from there. A fading gain is not changed.
    """

    def part(old: Ramp, new: Ramp) -> Ramp:
        start = old.value(last_tick)
        there = new.value(tick)
        if there == start:
            return new
        left = max(1, new.start_tick + new.ticks - tick)
        return Ramp(start + share * (there - start), new.end, tick, left)

    values = {place: part(before.values[place], ramp) for place, ramp in plan.values.items()}
    gain = plan.gain if plan.state in LATCHED else part(before.gain, plan.gain)
    if gain == plan.gain and values == plan.values:
        return plan
    return plan._replace(gain=gain, values=values)
