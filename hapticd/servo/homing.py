"""Finding the origin: push gently towards a stop or the encoder's index, and believe it when it is
there.

The push is the law itself with other numbers: a damper of 1 N s/m against the homing speed (what
any device renders passively with nothing else on), clamped at the homing force. While the encoder
stays within two counts the push grows to the full force in 0.2 s, so that friction is overcome and
falls back with the first motion; what has not moved 0.2 s later is the stop. Speed and force are
both bounded whatever is in the way.
"""

from hapticd.params import ServoParams
from hapticd.render.law import Environment
from hapticd.servo.commands import Now, enter
from hapticd.servo.plan import Plan
from hapticd.servo.safety import State
from hapticd.servo.state import Sample
from hapticd.units import round_half_up
from hapticd.wire.frames import Status

STILL_COUNTS = 2
PUSH_S = 0.2
STILL_S = 0.4
DAMPING_NS_PER_M = 1.0


def environment(plan: Plan, tick: int, params: ServoParams) -> Environment:
    """The law's numbers while homing: a damper and a push that grows while nothing moves,
    clamped at the homing force.
    """
    home = params.device.home
    limit_n = min(home.force_n, params.safety.force_limit_n, params.device.force_limit_n)
    still = (tick - plan.anchor[0]) / (PUSH_S * params.realtime.rate_hz)
    push = home.direction * min(
        home.force_n, DAMPING_NS_PER_M * home.speed_m_per_s + still * home.force_n
    )
    return 0.0, DAMPING_NS_PER_M, 0.0, push, limit_n, 0.0, 0.0, 0.0, 0.0, -1e3, 1e3, 0.0


def advance(plan: Plan, sample: Sample, now: Now, params: ServoParams) -> Plan:
    """`plan` after one tick of homing: still searching, or disabled with the origin found."""
    encoder, status, _, _, _, index_offset = sample
    home = params.device.home
    if home.method == "index" and status & Status.INDEX:
        return _done(plan, encoder - index_offset, now, params)
    anchor_tick, anchor = plan.anchor
    if abs(encoder - anchor) > STILL_COUNTS:
        return plan._replace(anchor=(now.tick, encoder))
    if home.method == "stop" and now.tick - anchor_tick >= STILL_S * params.realtime.rate_hz:
        return _done(plan, encoder, now, params)
    return plan


def overdue(plan: Plan, tick: int, params: ServoParams) -> bool:
    """Whether homing has searched longer than the device allows."""
    return (
        plan.state is State.HOMING
        and tick - plan.since_tick > params.device.home.timeout_s * params.realtime.rate_hz
    )


def _done(plan: Plan, count: int, now: Now, params: ServoParams) -> Plan:
    position = params.device.position
    origin = count - round_half_up(
        position.sign * params.device.home.position_m / position.per_count
    )
    return enter(plan, State.DISABLED, now, params, plan.actor)._replace(origin=origin, homed=True)
