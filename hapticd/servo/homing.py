"""Finding the origin: push gently towards a stop or the encoder's index, and believe it when it is there.

The push is the law itself with other numbers: force = F_home (1 - v / v_home) towards the stop, clamped at F_home, so speed
and force are both bounded whatever is in the way. A stop is found when the encoder has stayed within two counts for 0.2 s.
"""

from hapticd.faults import BY_CODE
from hapticd.params import ServoParams
from hapticd.render.environment import Environment
from hapticd.render.ramp import constant
from hapticd.servo.plan import Plan
from hapticd.servo.safety import State
from hapticd.servo.state import Sample
from hapticd.units import round_half_up
from hapticd.wire.frames import Status

STILL_COUNTS = 2
STILL_S = 0.2


def environment(params: ServoParams) -> Environment:
    """The law's numbers while homing: a damper of F/v and a constant push, clamped at the homing force."""
    home = params.device.home
    limit_n = min(home.force_n, params.safety.force_limit_n, params.device.force_limit_n)
    damping = home.force_n / home.speed_m_per_s
    return 0.0, damping, 0.0, home.direction * home.force_n, limit_n, 0.0, 0.0, 0.0, 0.0, -1e3, 1e3, 0.0


def advance(plan: Plan, sample: Sample, tick: int, params: ServoParams) -> Plan:
    """`plan` after one tick of homing: still searching, homed (disabled), or failed."""
    encoder, status, _, _, _, index_offset = sample
    home, rate_hz = params.device.home, params.realtime.rate_hz
    if home.method == "index" and status & Status.INDEX:
        return _done(plan, encoder - index_offset, tick, params)
    anchor_tick, anchor = plan.anchor
    if abs(encoder - anchor) > STILL_COUNTS:
        plan = plan._replace(anchor=(tick, encoder))
    elif home.method == "stop" and tick - anchor_tick >= STILL_S * rate_hz:
        return _done(plan, encoder, tick, params)
    if tick - plan.since_tick > home.timeout_s * rate_hz:
        fault = BY_CODE["home_failed"].number
        return plan._replace(
            state=State.FAULT, fault=fault, actor=0, since_tick=tick, added_entry=plan.added, revision=plan.revision + 1
        )
    return plan


def _done(plan: Plan, count: int, tick: int, params: ServoParams) -> Plan:
    position = params.device.position
    origin = count - round_half_up(position.sign * params.device.home.position_m / position.per_count)
    return plan._replace(
        state=State.DISABLED, since_tick=tick, origin=origin, homed=True, bias=constant(0.0), revision=plan.revision + 1
    )
