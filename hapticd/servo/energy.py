"""Limits on what a display may give out: energy of ramps, force step of a change, energy leaks.

Energy of ramps (`booked`, `paused`). A display that is passive at every instant may still be
pumped. A spring gives energy to the hand if it stiffens while deflected and softens while not. A
fixed rhythm reaches that phase by itself (parametric resonance). Example: a spring on 1 kg ramps
from 40 to 380 N/m and back, each in 50 ms and every 110 ms. The motion grows by a factor of 2.08 in
220 ms; with 2 N s/m by 1.68. No ledger of work shows this, because the energy that a ramp adds is
not lost.

So each tick books the energy that its change of parameters adds to the energy stored at the present
position of the handle, element by element:

    spring K, wall, ends        k d^2 / 2 at the deflection d; beyond the force limit F that the
                                law clamps to, F d - F^2 / (2 k)
    further springs k x^n       k x^(n + 1) / (n + 1); beyond the limit F d - F D n / (n + 1), with
                                D the deflection at which the force reaches it
    virtual mass M              M v^2 / 2 at the velocity of the law

Each term includes the gain and the wall's new place. An enable, a stiffer wall and a wall that
moves into the handle therefore add energy like a stiffer spring. Only increases count: a softer
spring takes energy out at another place than a stiffer one adds it, and the difference is the pump.

Ramps pause while the bookings of the last second and of this tick exceed `limits.ramp_energy_j` of
the device file. Every value then stays where it is, keeps the rest of its ramp, and continues when
the window frees. Decreases are never held: stiffness and mass on their way down, damping on its way
to 0, a wall that is removed, and whatever removes the whole force. So in any second a hand gets no
more than the budget, or the energy of a single tick, which `limits.force_step_n` bounds. The window
is kept in SHARES of a second, so it is 1.05 s at most. A parameter that stores energy must have a
`power`. Where force acts, parameters must not move past `eased`.

Force step (`eased`). Parameter changes in one tick are limited by the step of the force that the
device file allows.

    |F(x, v, a; parameters of this tick) - F(x, v, a; those of the last)| <= limits.force_step_n

Both are the law at the sample of this tick. The limit therefore applies to the step of an enable or
of a change of parameters, and not to an impact on a stiff wall. If that step is too large, all
ramping values, the gain included, move by a share of it and continue in the next tick. A ramp then
ends later than requested, and records show the values in force. A change that removes the whole
force (disable, stop, fault, the ramp from 0 after a gap) is not held back. Without a sample the
force is held, and during a stop or fault the acting force ramps down. In both cases the parameters
wait.

The energy of such a step is booked. If the bookings of the last second exceed the budget, the step
is computed again with changes of decreasing values only.

The force is continuous in the share, but neither monotonic nor linear (clamp, walls, gain times
value), so bisection finds the share. A step lies between half the bound and the bound, and any
change completes. The force must be a continuous function of its parameters, and parameters must
change on a ramp.

Energy leak (`controlled`). A controller ends a leak before it causes the fault `energy`: first with
active damping, then with a weaker environment. The ledger's excess E (`render.law`) is energy that
the display gave out without cover. In motion under an environment that the credited damping makes
passive, E stays below a twentieth of `limits.energy_j`, the bound of the fault. A leak exceeds any
bound: it grows by a fifth in a tick where a wall at five times its limit drives a light handle. So
beyond SHARE of that bound

    1. the active damping rises to the device's limit, with a separate slew. It acts in the board's
       analog circuit, without sampling and delay, and the level that the board then reports is
       credited in E;
    2. for every further STEP of the bound that leaks after that (twice as much until the active
       damping has taken effect), K, B and M and those of the wall are halved. The force steps by no
       more than `limits.force_step_n`. The next halving waits for the effect of this one.

The leak is counted from the last step on. E itself decays with a time constant of a second, so the
rest of the former excess is subtracted. Credit is not stored: E starts at 0 whenever the device
took more than it was given. Minutes without a leak therefore do not delay a step by a tick.

Both are changes by the servo itself: revision and environment revision count them, the actor is 0,
and they stay until a change sets the value again. No virtual damping is added. Behind a lag or a
delay it feeds the motion that it should brake; without them the halving is as effective. Behind a
first-order lag of the force (`force_smoothing_hz`, where a model contains it) E is booked with the
lagged force, mean of each period:

    f_n = e f_{n-1} + (1 - b) F_n + (b - e) F_{n-1},   e = exp(-w T), b = (1 - e) / (w T)

The controller acts while the fault `energy` is on, so never in a measurement, and only while force
acts. If the leak continues, the fault ends it. Limitations: an `energy_j` so large that a tenth of
it is too much for a hand, or a credit above the device's true damping.
"""

from math import ceil, exp, inf, isfinite, prod, tau
from typing import Final, NamedTuple

from hapticd.core.environment import FURTHER
from hapticd.core.params import ServoParams
from hapticd.mailbox.layout import STRENGTH_VALUES, Flag, Value, following
from hapticd.render.law import Coefficients, LawInputs, LawState, Ramp, render
from hapticd.servo.plan import Booking, Control, Plan, TickConstants, environment_of
from hapticd.servo.safety import LATCHED, Bounds, State

# --- energy of ramps ------------------------------------------------------------------------------

SHARES: Final = 20  # of a second: 21 bookings at most, in a checkpoint too
DAMPINGS = frozenset({Value.VIRTUAL_DAMPING, Value.WALL_VIRTUAL_DAMPING})  # store nothing
GAIN: Final = -1  # not a place of a command
WALL: Final = 1  # place among the elements that store energy
MOVES = frozenset({Value.WALL_POSITION, Value.WALL_SIDE})


def spring_energy(stiffness: float, deflection: float, limit: float, power: int = 1) -> float:
    """Return the energy [J] of a spring [N/m^power] at `deflection` [m] whose force is clamped to
    `limit` [N]. It is negative for a negative spring.
    """
    size = abs(stiffness)
    bent = abs(deflection)
    if size * bent**power <= limit:
        return prod([bent] * (power + 1), start=stiffness / (power + 1))
    reached = float((limit / size) ** (1.0 / power))
    clamped = limit * (bent - reached * power / (power + 1))
    return clamped if stiffness > 0.0 else -clamped


def stored(environment: LawInputs, x: float, v: float) -> tuple[float, ...]:
    """Return the energies [J] that the elements of `environment` store at `x` [m] and `v` [m/s].
    Order: spring, WALL, ends, mass, further springs.
    """
    stiffness, _, mass, bias, limit, wall_k, _, wall_x, side, lower, upper, end_k, *more = (
        environment
    )
    bent = x - bias / stiffness if bias and stiffness else x  # from the proxy
    depth = max(0.0, (x - wall_x) * side)
    beyond = max(0.0, x - upper, lower - x)
    return (
        spring_energy(stiffness, bent, limit),
        spring_energy(wall_k, depth, limit),
        spring_energy(end_k, beyond, limit),
        0.5 * mass * v * v,
        *(
            spring_energy(value, x, limit, one.power)
            for one, value in zip(FURTHER, more, strict=True)
            if one.power
        ),
    )


def added(before: tuple[float, ...], after: tuple[float, ...]) -> float:
    """Return the energy [J] gained by elements between the two, without the losses of others."""
    pairs = zip(before, after, strict=True)
    return sum([new - old for old, new in pairs if new > old])


def share_of(tick: int, rate_hz: float) -> int:
    """Return the number of the share of a second in which `tick` lies."""
    return int(tick * SHARES / rate_hz)


def booked(plan: Plan, energy_j: float, tick: int, rate_hz: float) -> Plan:
    """Return `plan` with `energy_j` > 0 booked at `tick`, and without bookings older
    than a second.
    """
    share = share_of(tick, rate_hz)
    *others, newest = plan.bookings or (Booking(share, 0.0),)
    if newest.share == share:
        return plan._replace(bookings=(*others, Booking(share, newest.energy_j + energy_j)))
    kept = [one for one in plan.bookings if one.share >= share - SHARES]
    return plan._replace(bookings=(*kept, Booking(share, energy_j)))


def too_much(plan: Plan, energy_j: float, tick: int, rate_hz: float, budget_j: float) -> bool:
    """Return whether `energy_j` must wait; never, if no energy was booked within the second."""
    if not energy_j > 0.0:
        return False
    oldest = share_of(tick, rate_hz) - SHARES
    recent = [one.energy_j for one in plan.bookings if one.share >= oldest]
    return bool(recent) and sum(recent) + energy_j > budget_j


def falls(place: int, start: float, there: float, wall_gains: bool) -> bool:
    """Return whether a value that goes from `start` to `there` decreases, so that its ramp is not
    held.
    """
    if place in MOVES:
        return not wall_gains
    if place in DAMPINGS:
        return start * there >= 0.0 and abs(there) < abs(start)
    return there < start


def paused(plan: Plan, before: Plan, last_tick: int, tick: int, wall_gains: bool) -> Plan:
    """Return `plan` with all values that do not fall kept as in `before` at `last_tick`, with the
    rest of their ramps. `wall_gains`: the wall would store more, so it does not move either.
    """

    def part(place: int, old: Ramp, new: Ramp) -> Ramp:
        start = old.value(last_tick)
        there = new.value(tick)
        if there == start or falls(place, start, there, wall_gains):
            return new
        # a ramp that starts in this tick has not progressed yet
        begun = max(min(last_tick, tick), new.start_tick)
        return Ramp(start, new.end, tick, max(1, new.start_tick + new.ticks - begun))

    values = {place: part(place, before.values[place], new) for place, new in plan.values.items()}
    return plan._replace(gain=part(GAIN, before.gain, plan.gain), values=values)


# --- force step -----------------------------------------------------------------------------------

HALVINGS = 40  # of the step of one tick: from the whole range of a value to an imperceptible step


class RateLimited(NamedTuple):
    """A plan whose parameters moved as far as allowed in this tick."""

    plan: Plan
    flags: int  # of the record: EASED, PAUSED
    step_n: float = 0.0  # of the force, by the parameters


class Step(NamedTuple):
    """A step of the parameters, and the resulting environment."""

    plan: Plan
    environment: LawInputs
    size_n: float = 0.0  # of the force


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
        return with_flag(plan, step.plan)._replace(step_n=step.size_n)
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
        size_n = abs(force_n - here.force_n)
        if not size_n > bound_n:
            return Step(candidate, environment, size_n)
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
    was = stored(here.environment, here.x, here.v)
    now = stored(step.environment, here.x, here.v)
    energy_j = added(was, now)
    flags = with_flag(plan, step.plan).flags
    if too_much(plan, energy_j, here.tick, rate_hz, budget_j):
        wall_gains = now[WALL] > was[WALL]
        waiting = paused(plan, before, here.last_tick, here.tick, wall_gains)
        step = stepped(waiting, before, here, params)
        flags = with_flag(waiting, step.plan).flags | int(Flag.PAUSED)
        energy_j = added(was, stored(step.environment, here.x, here.v))
    if not energy_j > 0.0:
        return RateLimited(step.plan, flags, step.size_n)
    return RateLimited(booked(step.plan, energy_j, here.tick, rate_hz), flags, step.size_n)


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


# --- energy leak ----------------------------------------------------------------------------------

SHARE: Final = 0.06  # of the fault's bound: threshold of the controller
STEP: Final = 0.025  # of it: leak before the next halving
SHOWS_TICKS: Final = 3  # from a step to its effect at the board, at a delay of two periods


def is_on(params: ServoParams) -> bool:
    """Return whether it is configured and the ledger has a bound."""
    return params.safety.energy_controller and (params.device.physical_damping_ns_per_m is not None)


def budget_j(params: ServoParams) -> float:
    """Return the excess [J] above which the controller acts; infinite if it is off."""
    return SHARE * params.device.energy_limit_j if is_on(params) else inf


def lag(params: ServoParams) -> tuple[float, float, float] | None:
    """Return the lag of the force behind its command on this device, if it matters.

    The numbers are weights for a period's mean force: of the mean of the period before, the force
    commanded for this period, and that of the period before.
    """
    corner_hz = params.device.force_smoothing_hz
    if not is_on(params) or not corner_hz > 0.0:
        return None
    angle = tau * corner_hz / params.realtime.rate_hz
    kept = exp(-angle)
    mean = (1.0 - kept) / angle
    return kept, 1.0 - mean, mean - kept


def controlled(
    plan: Plan, excess_j: float, ticks: tuple[int, int], params: ServoParams, bound: Bounds
) -> Plan:
    """Return `plan` after the reaction to `excess_j` [J]; the same object without one. `ticks`: the
    last one and this one.
    """
    last_tick, tick = ticks
    if not excess_j > budget_j(params) or not plan.limit_cycle_faults:
        return plan
    if plan.state is not State.ENABLED or plan.unauthorised:
        return plan
    ceiling = params.device.active_damping_limit_ns_per_m
    now = Control(plan.control.places, tick, excess_j)
    if ceiling > (plan.active_damping_asked if plan.active_damping_on else 0.0):
        more = changed(plan, now, (Value.ACTIVE_DAMPING,))
        return more._replace(active_damping_asked=ceiling, active_damping_on=True)
    # since the last step, above the decayed excess of that time
    left_j = plan.control.excess_j * bound.kept ** (tick - plan.control.tick)
    leaked = (excess_j - left_j) / params.device.energy_limit_j
    untried = plan.control.places == (Value.ACTIVE_DAMPING,)
    waiting = not untried and tick - plan.control.tick < shows_ticks(params)
    if waiting or leaked <= (2.0 if untried else 1.0) * STEP:
        return plan
    return halved(plan, now, last_tick)


def shows_ticks(params: ServoParams) -> int:
    """Return the ticks until a halving appears in the force of this device."""
    corner_hz = params.device.force_smoothing_hz
    settling = params.realtime.rate_hz / (tau * corner_hz) if corner_hz > 0.0 else 0.0
    return SHOWS_TICKS + ceil(settling)


def halved(plan: Plan, now: Control, last_tick: int) -> Plan:
    """Return `plan` with half of the values in force at `last_tick`; at once as far as the force
    step allows. Easing may have held them back.
    """
    in_force = {place: plan.values[place].value(last_tick) for place in STRENGTH_VALUES}
    felt = {place: value for place, value in in_force.items() if value}
    if not felt:
        return plan
    ramps = {place: Ramp(value, 0.5 * value, now.tick, 0) for place, value in felt.items()}
    return changed(plan, now, tuple(felt))._replace(values=plan.values | ramps)


def changed(plan: Plan, now: Control, places: tuple[int, ...]) -> Plan:
    """Return `plan` with a change of `places` by the servo itself."""
    held = tuple(sorted({*now.places, *map(int, places)}))
    return plan._replace(
        control=now._replace(places=held),
        actor=0,
        revision=following(plan.revision),
        environment_revision=following(plan.environment_revision),
    )
