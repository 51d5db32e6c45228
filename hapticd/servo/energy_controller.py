"""End an energy leak before it causes the fault `energy`: first with active damping, then with a
weaker environment.

The ledger's excess E (`render.energy`) is energy that the display gave out without cover. In motion
under an environment that the credited damping makes passive, E stays below a twentieth of
`limits.energy_j`, the bound of the fault. A leak exceeds any bound: it grows by a fifth in a tick
where a wall at five times its limit drives a light handle. So beyond SHARE of that bound

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
acts. If the leak continues, the fault ends it.

Limitations: an `energy_j` so large that a tenth of it is too much for a hand, or a credit above the
device's true damping.
"""

from math import ceil, exp, inf, tau
from typing import Final

from hapticd.core.params import ServoParams
from hapticd.mailbox.layout import STRENGTH_VALUES, Value, following
from hapticd.render.ramp import Ramp
from hapticd.servo.monitors import Bounds
from hapticd.servo.plan import Control, Plan
from hapticd.servo.safety import State

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
