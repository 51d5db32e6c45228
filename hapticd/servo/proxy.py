"""The proxy: the anchor of the virtual spring, moved by the law of a client (ADR-0034).

The spring acts on x - p, with p the position of the proxy, 0 without a law. B, M, walls, ends of
the workspace and the limit act on the handle as before: with a proxy at rest, the loop is the one
that the guard has judged, shifted by p. It is at rest between two ticks. At a tick the spring can
only gain

    dE = U(x - p') - U(x - p),   U the energy of the spring up to the force limit

so the law gives out no more energy at the handle than this sum at its own port. The delay of the
loop adds at most K |v| |dp| for the time from the sample to the force. A move is made only within
all these bounds:

    sender      holds the lease of the environment
    state       enabled, with verified signs and a fresh sample
    range       the workspace; NaN is outside
    speed       `proxy_speed_m_per_s`, and a step of force of at most `limits.force_step_n`
    time        `proxy_timeout_s` after the last target it stays, so also if the law has died
    energy      the sum of dE is at most `proxy_energy_j`. What is above 0 decays with
                `proxy_power_w`; below 0 it stays, at most `proxy_stored_j`. A move that takes
                energy from the spring is always made

A target is reached after the time between it and the target before, so that a slow law moves the
proxy smoothly. A proxy that is held stays where it is; it never jumps, nor returns by itself. It
ends without force: at disable, at the end of a stop ramp, and with K = 0 after its lease.

The position must not change while `energy.eased` compares two ticks: ramps go first.
"""

from math import inf

from hapticd.core.params import ServoParams
from hapticd.mailbox.layout import Value
from hapticd.render.law import approach
from hapticd.servo.energy import spring_energy
from hapticd.servo.plan import NO_PROXY, Plan, Proxy, Request, proxy_ticks
from hapticd.servo.safety import State

__all__ = ["aimed", "moved"]


def aimed(plan: Plan, request: Request, tick: int, params: ServoParams) -> Plan:
    """Return `plan` with the target of `request`; the same object if it is not allowed."""
    _, _, actor, _, values = request
    target_m = values[Value.PROXY]
    ends = params.soft_ends
    inside = ends.lower_m <= target_m <= ends.upper_m  # not true of NaN
    allowed = plan.state is State.ENABLED and not params.device.commissioning
    if not (inside and allowed and actor == plan.leases[0]):
        return plan
    proxy = plan.proxy
    ticks = max(1, min(tick - proxy.asked_tick, proxy_ticks(params)))
    return plan._replace(
        proxy=proxy._replace(
            owner=actor,
            target_m=target_m,
            step_m=abs(target_m - proxy.position_m) / ticks,
            asked_tick=tick,
        )
    )


def moved(plan: Plan, x: float | None, tick: int, params: ServoParams) -> Plan:
    """Return `plan` with its proxy moved at this tick's position `x` [m]; None: no sample."""
    proxy = plan.proxy
    gain = plan.gain.value(tick)
    spring = plan.values[Value.STIFFNESS]
    if plan.state is not State.ENABLED:
        return plan if gain > 0.0 else plan._replace(proxy=NO_PROXY)
    left = proxy.owner != plan.leases[0]
    if left and not spring.running(tick) and spring.end == 0.0:
        return plan._replace(proxy=NO_PROXY)
    late = tick - proxy.asked_tick > proxy_ticks(params)
    if left or late:
        return plan._replace(proxy=proxy._replace(held=True))
    if x is None:
        return plan
    stiffness = gain * spring.value(tick)
    return plan._replace(proxy=_step(proxy, x, stiffness, gain, tick, params))


def _step(
    proxy: Proxy, x: float, stiffness: float, gain: float, tick: int, params: ServoParams
) -> Proxy:
    """Return `proxy` a step further, or held if it has no energy for it."""
    safety = params.safety
    rate_hz = params.realtime.rate_hz
    at_once = params.device.force_step_n / abs(stiffness) if stiffness else inf
    step_m = min(proxy.step_m, safety.proxy_speed_m_per_s / rate_hz, at_once)
    there = approach(proxy.position_m, proxy.target_m, step_m)
    limit_n = gain * params.force_limit_n
    added_j = spring_energy(stiffness, x - there, limit_n) - spring_energy(
        stiffness, x - proxy.position_m, limit_n
    )
    granted_j = safety.proxy_power_w * (tick - proxy.moved_tick) / rate_hz
    used_j = max(0.0, proxy.energy_j - granted_j) if proxy.energy_j > 0.0 else proxy.energy_j
    if added_j > 0.0 and used_j + added_j > safety.proxy_energy_j:
        return proxy._replace(held=True)
    return proxy._replace(
        position_m=there,
        moved_tick=tick,
        energy_j=max(used_j + added_j, -safety.proxy_stored_j),
        held=False,
    )
