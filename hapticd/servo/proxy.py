"""The proxy: the anchor of the virtual spring, moved by the law of a client (ADR-0034).

The spring acts on x - p, with p the position of the proxy, 0 without a law. B, M, walls, ends of
the workspace and the limit act on the handle as before: with a proxy at rest, the loop is the one
that the guard has judged, shifted by p. It is at rest between two ticks. At a tick the spring can
only gain

    dE = U(x - p') - U(x - p),   U the energy of the spring up to the force limit

so the law gives out no more energy at the handle than this sum at its own port. The sum is exact
but for the delay of the loop, which adds at most K |v| |dp| for the time from the sample to the
force. It counts the spring at the force limit alone. Beside a wall, B or M at the limit the hand
may get up to twice as much. A move is made only within all these bounds:

    sender      holds the lease of the environment
    state       enabled, with verified signs and a sample that is believed
    range       the workspace; NaN is outside
    speed       `proxy_speed_m_per_s`, and a step of force of at most `limits.force_step_n`,
                together with that of changes of parameters in the same tick
    time        the proxy stays where it is `proxy_timeout_s` after the last target, also if the law
                has ended
    energy      the sum of dE is at most `proxy_energy_j`. What is above 0 decays with
                `proxy_power_w`, also while there is no proxy; below 0 it stays, at most
                `proxy_stored_j`, until K or the gain raises the strength of the spring. Energy that
                is taken afterwards counts in full, also what the ramp added: `servo.energy` bounds
                that. A move that takes energy from the spring is always made

A target is reached after the time between it and the target before, so that a slow law moves the
proxy smoothly. A held proxy never jumps and never returns by itself. It is set to 0 without force:
at disable, at the end of a stop ramp, and at K = 0 after its lease.

The position must not change while `energy.eased` compares two ticks: ramps go first.
"""

from math import inf

from hapticd.core.params import ServoParams
from hapticd.mailbox.layout import Value
from hapticd.render.law import approach
from hapticd.servo.energy import spring_energy
from hapticd.servo.plan import NO_PROXY, Plan, Proxy, Request, masked_places, proxy_ticks
from hapticd.servo.safety import State

__all__ = ["aimed", "moved", "without_proxy"]


def without_proxy(plan: Plan) -> Plan:
    """Return `plan` without a proxy. Used energy stays used, so that no proxy that begins again has
    more.
    """
    used = plan.proxy
    return plan._replace(
        proxy=NO_PROXY._replace(energy_j=max(0.0, used.energy_j), moved_tick=used.moved_tick)
    )


def aimed(plan: Plan, request: Request, tick: int, params: ServoParams) -> Plan:
    """Return `plan` with the target of `request`; the same object if it is not allowed."""
    _, _, actor, _, values = request
    target_m = values[Value.PROXY]
    ends = params.soft_ends
    inside = ends.lower_m <= target_m <= ends.upper_m  # not true of NaN
    given = inside and Value.PROXY in masked_places(values)
    allowed = plan.state is State.ENABLED and not params.device.commissioning
    if not (given and allowed and actor == plan.leases[0]):
        return plan
    proxy = plan.proxy
    # of two targets in one tick, the second replaces the first
    ticks = min(tick - proxy.asked_tick or proxy.ticks, proxy_ticks(params))
    return plan._replace(
        proxy=proxy._replace(
            owner=actor,
            target_m=target_m,
            step_m=abs(target_m - proxy.position_m) / ticks,
            asked_tick=tick,
            ticks=ticks,
        )
    )


def moved(
    plan: Plan,
    x: float | None,
    tick: int,
    params: ServoParams,
    last_n_per_m: float,
    stepped_n: float,
) -> Plan:
    """Return `plan` with its proxy moved at this tick's position `x` [m]; None: no sample to trust.

    `last_n_per_m`: stiffness of the spring in the last tick, gain included; `stepped_n`: step of
    the force that changes of parameters make in this tick.
    """
    proxy = plan.proxy
    gain = plan.gain.value(tick)
    spring = plan.values[Value.STIFFNESS]
    if plan.state is not State.ENABLED:
        return plan if gain > 0.0 else without_proxy(plan)
    left = proxy.owner != plan.leases[0]
    if left and not spring.running(tick) and spring.end == 0.0:
        return without_proxy(plan)
    stiffness_n_per_m = gain * spring.value(tick)
    if stiffness_n_per_m > last_n_per_m:  # a ramp ends the credit from before it
        proxy = proxy._replace(energy_j=max(0.0, proxy.energy_j))
    late = tick - proxy.asked_tick > proxy_ticks(params)
    if left or late:
        proxy = proxy._replace(held=True)
    elif x is not None and proxy.moved_tick != tick:  # a tick may be repeated
        left_n = max(0.0, params.device.force_step_n - stepped_n)
        proxy = _step(proxy, x, stiffness_n_per_m, gain, left_n, tick, params)
    return plan._replace(proxy=proxy)


def used_j(proxy: Proxy, tick: int, params: ServoParams) -> float:
    """Return the energy [J] that the law has used; negative: that it may return."""
    granted_j = params.safety.proxy_power_w * (tick - proxy.moved_tick) / params.realtime.rate_hz
    return max(0.0, proxy.energy_j - granted_j) if proxy.energy_j > 0.0 else proxy.energy_j


def _step(
    proxy: Proxy,
    x: float,
    stiffness_n_per_m: float,
    gain: float,
    left_n: float,
    tick: int,
    params: ServoParams,
) -> Proxy:
    """Return `proxy` a step further, or held if it has no energy for it."""
    safety = params.safety
    force_step_m = left_n / abs(stiffness_n_per_m) if stiffness_n_per_m else inf
    speed_step_m = safety.proxy_speed_m_per_s / params.realtime.rate_hz
    step_m = min(proxy.step_m, speed_step_m, force_step_m)
    next_m = approach(proxy.position_m, proxy.target_m, step_m)
    limit_n = gain * params.force_limit_n
    added_j = spring_energy(stiffness_n_per_m, x - next_m, limit_n) - spring_energy(
        stiffness_n_per_m, x - proxy.position_m, limit_n
    )
    energy_j = used_j(proxy, tick, params) + added_j
    if added_j > 0.0 and energy_j > safety.proxy_energy_j:
        return proxy._replace(held=True)
    return proxy._replace(
        position_m=next_m,
        moved_tick=tick,
        energy_j=max(energy_j, -safety.proxy_stored_j),
        held=False,
    )
