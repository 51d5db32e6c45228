"""Frames withheld on purpose, to test the board's watchdog.

Only a disabled servo withholds them, for a second at most, because the board holds its damping for
two. It sends nothing. It reads every 8 ms only, to notice a lost link: no frame answers, so each
read takes its time-out, and slots that are lost by it are not counted. Every end of the state (a
stop, a fault, an enable) ends the silence in that tick.

The first frame after the silence requests authority with the count of no force. A board whose
watchdog has tripped reports this in its answer and does nothing else, so its IN contains the
damping that it holds. The next frame has no ENABLE again, which clears a tripped watchdog. A board
that has not tripped has authority over no force for one period: that is the price of an answer.

No force may act in the state disabled, and the board must hold damping for as long as a silence may
take.
"""

from hapticd.core.params import ServoParams
from hapticd.core.units import round_half_up
from hapticd.mailbox.layout import Result, Value, following
from hapticd.servo.plan import Plan, masked_places, out_of_range
from hapticd.servo.safety import State
from hapticd.usb.frames import OutFlag

ENABLE = int(OutFlag.ENABLE)
LISTEN_S = 8e-3
WITHHELD = 0x100  # above the eight flags of an OUT frame: no frame is sent


def flags_of(plan: Plan, tick: int) -> int:
    """Return the flags of the OUT frame of a silent servo."""
    return WITHHELD if tick < plan.silent_until else ENABLE


def listens(plan: Plan, slot: int, rate_hz: float) -> bool:
    """Return whether the tick after `slot` of a silence reads, in vain.

    A lost link is then noticed, and a simulated board advances. The last ticks do not read, because
    the board's answer follows them.
    """
    every = round_half_up(LISTEN_S * rate_hz)
    return (plan.silent_until - slot) % (every + 1) == every


def begun(
    plan: Plan, values: tuple[float, ...], tick: int, params: ServoParams
) -> tuple[Plan, Result]:
    """Return `plan` silent from `tick` on, or why it may not be."""
    if plan.state is not State.DISABLED or plan.silent_until:
        return plan, Result.REFUSED_STATE
    if Value.SILENCE_S not in masked_places(values) or out_of_range(values, params):
        return plan, Result.REFUSED_RANGE
    ticks = max(1, round_half_up(values[Value.SILENCE_S] * params.realtime.rate_hz))
    silent = plan._replace(silent_until=tick + ticks, revision=following(plan.revision))
    return silent, Result.APPLIED


def followed(plan: Plan, sent_flags: int) -> Plan:
    """Return `plan` after a tick whose frame had `sent_flags`: the silence ends with the request
    for authority.
    """
    asked = plan.silent_until and sent_flags & ENABLE
    return plan._replace(silent_until=0) if asked else plan
