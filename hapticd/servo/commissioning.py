"""The monitor of a device whose signs are not verified: every push, from its first force.

With a wrong sign of force or position, each spring drives the handle instead of holding it, and no
value of the law shows this. Until a person has verified the direction of a push (`hapticd rig
motor`), the force is limited to a tenth of the device's (`ServoParams.force_limit_n`). K, B and M
are limited too (`mailbox.layout.COMMISSIONING_LIMITS`), and homing is refused. A push ends with the
fault `commissioning` when

    the handle is TRAVEL_M from where force began,
    force has acted for FORCE_S since the servo was enabled, or
    the handle has done more work against the force than its largest so far does in AGAINST_M:
    the motion has the wrong direction, or a hand works against it.

The work against the force is counted from its minimum, so earlier work with the force does not
offset it. A hand that presses a spring or moves through a damper looks just like a wrong sign, and
ends the force within a millimetre too: commissioning is for pushes. Positions are those that the
law used, at most a tick old.

The origin must not change under force (only `zero` changes it, and it is then refused).
"""

from typing import Final, NamedTuple

from hapticd.core.faults import BY_CODE
from hapticd.core.params import ServoParams

TRAVEL_M: Final = 10e-3
FORCE_S: Final = 20.0
AGAINST_M: Final = 0.5e-3

COMMISSIONING = BY_CODE["commissioning"].number


class Push(NamedTuple):
    """The state of a push; none has begun as long as `start_tick` is negative."""

    start_tick: int = -1  # of the first force since the servo was enabled
    start_m: float = 0.0  # position of the handle then
    last_m: float = 0.0  # last position
    against_j: float = 0.0  # work of the handle against the force
    most_n: float = 0.0  # largest force so far


def followed(push: Push, x: float, force_n: float, tick: int, params: ServoParams) -> Push:
    """Return `push` at `tick` with the handle at `x` [m], after `force_n` acted."""
    if push.start_tick < 0:
        pushes = abs(force_n) > params.device.force.per_count
        return Push(tick, x, x, 0.0, abs(force_n)) if pushes else push
    against_j = max(0.0, push.against_j - force_n * (x - push.last_m))
    most_n = max(push.most_n, abs(force_n))
    return push._replace(last_m=x, against_j=against_j, most_n=most_n)


def push_ended(push: Push, tick: int, params: ServoParams) -> int:
    """Return the number of the fault that ends `push` at `tick`, 0 for none."""
    if push.start_tick < 0:
        return 0
    ended = (
        abs(push.last_m - push.start_m) > TRAVEL_M
        or tick - push.start_tick > FORCE_S * params.realtime.rate_hz
        or push.against_j > AGAINST_M * push.most_n
    )
    return COMMISSIONING if ended else 0
