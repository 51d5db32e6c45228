"""How far parameters move in one tick: no further than the device file lets the force step.

    |F(x, v, a; parameters of this tick) - F(x, v, a; those of the last)| <= limits.force_step_n

Both are the law at the sample of this tick, so the step of a stiff wall that is hit passes as it
is; bounded is what an enable or a change of parameters adds to it. Where that would be too much,
all that is on its way, gain and values alike, goes a share of the way and on from there in the next
tick: a ramp ends later than asked, and records show the values that were in force. Whatever takes
force away as a whole (disable, stop, fault, the ramp from 0 after a gap) is not held back. While
there is no sample the force is held, and while a stop or fault fades it what acted goes on: in both
parameters wait where they are.

The force is continuous in the share, but neither monotonous nor linear (clamp, walls, gain times
value), so a share is found by halving: a step lies between half the bound and the bound, and any
change arrives.

What would break it: a force that is no continuous function of its parameters, or parameters that
change without a ramp.
"""

from math import isfinite

from hapticd.params import ServoParams
from hapticd.render.law import Coefficients, LawState, render
from hapticd.render.ramp import Ramp
from hapticd.servo.plan import Plan, Settled, environment_of
from hapticd.servo.safety import LATCHED, State

HALVINGS = 40  # of the way of one tick: from the whole range of any value to nothing felt


def eased(
    plan: Plan,
    settled: Settled,
    x: float | None,
    law: LawState,
    coefficients: Coefficients,
    tick: int,
    params: ServoParams,
) -> Plan:
    """`plan` with its parameters as far on their way at `tick` as the device's force step allows.

    `settled` is of the tick before, `law` and `coefficients` are those that this tick's position
    `x` [m] meets; None: there is no sample, and the force is held.
    """
    before = settled.plan
    last_tick = settled.wake_tick - 1  # while a ramp runs; else any tick gives the same values
    if plan.state in LATCHED:
        fading = plan.gain.value(tick) > 0.0 and isfinite(params.device.force_step_n)
        return on_the_way(plan, before, last_tick, tick, 0.0) if fading else plan
    if plan.state is not State.ENABLED or plan.gain.value(tick) < before.gain.value(last_tick):
        return plan
    if x is None:
        return on_the_way(plan, before, last_tick, tick, 0.0)
    here = x
    bound_n = params.device.force_step_n
    limit_n = min(params.safety.force_limit_n, params.device.force_limit_n)
    workspace = params.environment.workspace
    was_n, *_ = render(here, law, settled.environment, coefficients)

    def too_far(candidate: Plan) -> bool:
        environment = environment_of(candidate, tick, workspace, limit_n)
        force_n, *_ = render(here, law, environment, coefficients)
        return abs(force_n - was_n) > bound_n

    share = 1.0
    candidate = plan
    for _ in range(HALVINGS):
        if not too_far(candidate):
            return candidate
        share *= 0.5
        candidate = on_the_way(plan, before, last_tick, tick, share)
    return on_the_way(plan, before, last_tick, tick, 0.0)


def on_the_way(plan: Plan, before: Plan, last_tick: int, tick: int, share: float) -> Plan:
    """`plan` with every parameter at `tick` only `share` of the way from where `before` had it at
    `last_tick`, and on its way from there; a gain that fades goes its own way.
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
