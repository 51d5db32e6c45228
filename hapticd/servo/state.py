"""The types one tick passes on, and the flags the loop tells it.

What changes with every sample is a plain tuple, which CPython takes apart and builds at the speed
of C; what only `attend` changes is one frozen object with named slots that a calm tick passes on
untouched.
"""

from dataclasses import dataclass
from typing import Any, Final

from hapticd.render.energy import Ledger
from hapticd.render.law import Coefficients, Environment, LawState
from hapticd.servo.plan import Plan, Wave
from hapticd.wire.frames import Status


@dataclass(frozen=True, slots=True)
class Settled:
    """What a tick needs of the plan, in the form it needs it; holds until `attend` is called
    again.
    """

    wake_tick: int  # look at the plan again at this tick
    environment: Environment
    coefficients: Coefficients
    out_flags: int  # of the OUT frame
    damping_count: int
    blob: bytes  # layout.PLAN
    origin: int  # encoder count at x = 0
    added: float  # added electrical damping / period [N/m]
    host: int  # host flags it was made under
    wave: Wave  # the plan's
    plan: Plan


Held = tuple[int, float]  # what was sent last: torque count, force [N]
ServoState = tuple[Settled, LawState, Ledger, Held]
SETTLED: Final = 0  # place in a ServoState
# encoder, status, temperature count, arrival (link.device), host flags, index offset
Sample = tuple[int, int, int, int, int, int]
# torque count, position, velocity, acceleration, force parts K B M field, force as sent, record
# flags, answers
Output = tuple[int, float, float, float, float, float, float, float, float, int, tuple[Any, ...]]
# seq, kind, actor, apply tick, values
Request = tuple[int, int, int, int, tuple[float, ...]]
# seq, result, fault, revision, (first tick, ramp-end tick), effective values
Answer = tuple[int, int, int, int, tuple[int, int], tuple[float, ...]]

# host flags
LINK_UP = 1
GATEWAY_ALIVE = 2

BOARD_FAULT = int(Status.AMPLIFIER_FAULT | Status.ENCODER_FAULT)
CLEARABLE = BOARD_FAULT | int(Status.OVER_TEMPERATURE)  # what CLEAR_FAULT may end
ATTENTION = int(Status.WATCHDOG | Status.OVER_TEMPERATURE) | BOARD_FAULT
