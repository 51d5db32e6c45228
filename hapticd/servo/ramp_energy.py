"""The energy that changes of parameters add, and the budget that makes ramps wait.

A display that is passive at every instant may still be pumped. A spring gives energy to the hand if
it stiffens while deflected and softens while not. A fixed rhythm reaches that phase by itself
(parametric resonance). Example: a spring on 1 kg ramps from 40 to 380 N/m and back, each in 50 ms
and every 110 ms. The motion grows by a factor of 2.08 in 220 ms; with 2 N s/m by 1.68. No ledger of
work shows this, because the energy that a ramp adds is not lost.

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
is kept in SHARES of a second, so it is 1.05 s at most.

A parameter that stores energy must have a `power`. Where force acts, parameters must not move past
`eased`.
"""

from math import prod
from typing import Final

from hapticd.core.environment import FURTHER
from hapticd.mailbox.layout import Value
from hapticd.render.law import LawInputs
from hapticd.render.ramp import Ramp
from hapticd.servo.plan import Booking, Plan

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
    stiffness, _, mass, _, limit, wall_k, _, wall_x, side, lower, upper, end_k, *more = environment
    depth = max(0.0, (x - wall_x) * side)
    beyond = max(0.0, x - upper, lower - x)
    return (
        spring_energy(stiffness, x, limit),
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
