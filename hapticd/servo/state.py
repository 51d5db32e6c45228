"""The types one tick passes on, and the flags the loop tells it."""

from typing import Any

from hapticd.render.energy import Ledger
from hapticd.render.environment import Coefficients, Environment, LawState
from hapticd.servo.plan import Plan
from hapticd.wire.frames import Status

# wake_tick, environment, coefficients, OUT flags, damping count, plan blob, law state, ledger, origin count,
# added damping per period [N/m], held (torque count, force [N]), host flags, plan
ServoState = tuple[int, Environment, Coefficients, int, int, bytes, LawState, Ledger, int, float, tuple[int, float], int, Plan]
# encoder, status, temperature count, arrival (link.device), host flags, index offset
Sample = tuple[int, int, int, int, int, int]
# torque count, position, velocity, acceleration, force parts K B M field, force as sent, record flags, answers
Output = tuple[int, float, float, float, float, float, float, float, float, int, tuple[Any, ...]]
# seq, kind, actor, apply tick, values
Request = tuple[int, int, int, int, tuple[float, ...]]
# seq, result, fault, revision, (first tick, ramp-end tick), effective values
Answer = tuple[int, int, int, int, tuple[int, int], tuple[float, ...]]

LINK_UP, GATEWAY_ALIVE = 1, 2  # host flags

BOARD_FAULT = int(Status.AMPLIFIER_FAULT | Status.ENCODER_FAULT)
CLEARABLE = BOARD_FAULT | int(Status.OVER_TEMPERATURE)  # what CLEAR_FAULT may end
ATTENTION = int(Status.WATCHDOG | Status.OVER_TEMPERATURE) | BOARD_FAULT
