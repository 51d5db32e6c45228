"""Loss of damping and force in a winding that warms up from 20 to 80 degC, with and without the
compensation of its resistance.

The whole stack in lock-step with the device `warming`, on virtual time. A hand pushes the handle
against a spring until the winding is warmer. Every two seconds it lets go for a moment, the servo
is disabled (active damping stays on), and a constant push moves the handle at a steady speed:

    delivered damping   -(motor force) / (velocity), both from the records: the board's current
                        times the force constant, and the encoder's velocity
    torque gain         motor force / commanded force while the spring is held still

The figure is the largest deviation of either from its first value, at 20 degC. Its yardstick is the
same flight with a board whose resistance DAC is not connected.

    device   g = 1.74 N s/m, K = 1.65 N/A, R = 1.6 ohm: g R / K^2 = 1.02, so 60 K cost 19 %

Limitations: velocity from the back-EMF, which the residual resistance falsifies by the very factor
to be measured.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks import targets
from benchmarks.figures import Figure, compared
from hapticd.core.params import ServoParams
from hapticd.mailbox import layout
from hapticd.mailbox.layout import Command, Value
from hapticd.model.params import BoardParams, HandParams, TouchParams
from hapticd.run.lockstep import LockStep
from hapticd.settings.build import board_params, servo_params
from hapticd.settings.load import Override, load
from hapticd.settings.toml import shipped

TARGETS = targets.of("thermal")
RECORD = np.dtype(list(layout.TELEMETRY))
DAMPING_NS_PER_M = 1.74
STIFFNESS_N_PER_M = 600.0
HEATING_N = 5.0  # 3 A: 14 W
PUSH_N = 0.6  # 0.3 m/s against the damping
ENABLE_S = 0.05
CYCLE_S = 2.0
FIRST_S = 1.0  # until the motion has settled
HEATED_S = 1.6  # of a cycle
MOVED_S = (1.8, 0.04)  # start in the cycle, and duration
STILL_TICKS = slice(280, 320)  # after the enable: the spring has swung out
CYCLES = 6  # until it is warmer than 80 degC
SIM_TICKS_PER_S = 1000


class Delivered(NamedTuple):
    """Results at one moment of the flight."""

    winding_c: float
    active_damping_ns_per_m: float
    torque_gain: float


def device(lacks: tuple[str, ...] = ()) -> tuple[ServoParams, BoardParams]:
    """Return servo and board of the device `warming`; the board lacks these capabilities."""
    asked = (
        Override(("device",), "warming", "benchmark"),
        Override(("simulation", "board", "lacks"), list(lacks), "benchmark"),
    )
    settings = load(shipped("config") / "hapticd.toml", asked)
    board = board_params(settings)
    assert board is not None
    servo = servo_params(settings, "thermal")
    # an uncompensated winding delivers less damping than the energy ledger assumes
    safety = replace(servo.safety, enable_ramp_s=ENABLE_S, limit_cycle_faults=False)
    return replace(servo, safety=safety), board


def touched(board: BoardParams, cycles: int) -> BoardParams:
    """Return `board` with the hands of the flight: one initial push, then heat and motion."""
    hands = [HandParams("push", FIRST_S - 0.2, MOVED_S[1], PUSH_N)]
    for cycle in range(cycles):
        start_s = FIRST_S + cycle * CYCLE_S
        hands.append(HandParams("push", start_s + 0.1, HEATED_S - 0.1, HEATING_N))
        hands.append(HandParams("push", start_s + MOVED_S[0], MOVED_S[1], PUSH_N))
    return replace(board, touch=TouchParams(hands=tuple(hands)))


def flown(params: ServoParams, board: BoardParams, cycles: int) -> Iterator[Delivered]:
    """Yield the moments of a flight, the first one at ambient temperature."""
    damping = {Value.ACTIVE_DAMPING: DAMPING_NS_PER_M, Value.ACTIVE_DAMPING_ON: 1.0}
    with LockStep(params, touched(board, cycles), keep=False) as stack:
        stack.do(Command.DAMPING, damping)
        stack.do(Command.SET, {Value.STIFFNESS: STIFFNESS_N_PER_M, Value.RAMP_S: 0.0})
        moved = _until(stack, FIRST_S)
        for cycle in range(cycles):
            start_s = FIRST_S + cycle * CYCLE_S
            stack.do(Command.ENABLE)
            held = _until(stack, start_s + HEATED_S)
            yield _delivered(params, moved, held)
            _until(stack, start_s + HEATED_S + 0.1)  # the hand has let go, the spring swings out
            stack.do(Command.DISABLE)
            moved = _until(stack, start_s + CYCLE_S)


def _until(stack: LockStep, seconds: float) -> npt.NDArray[np.void]:
    """Return records up to that time since the first tick."""
    ticks = round(seconds * SIM_TICKS_PER_S) - stack.loop.slot
    return np.frombuffer(stack.run(ticks), dtype=RECORD)


def _delivered(
    params: ServoParams, moved: npt.NDArray[np.void], held: npt.NDArray[np.void]
) -> Delivered:
    """Evaluate the fastest ticks of a steady motion, and a force held after it."""
    table = params.device.resistance
    assert table is not None
    steady = moved[np.argsort(np.abs(moved["velocity_m_per_s"]))[-10:]]
    force_n = table.force_n_per_a * steady["current_a"].astype(float)
    damping = -float(np.mean(force_n) / np.mean(steady["velocity_m_per_s"]))
    still = held[STILL_TICKS]
    gain = table.force_n_per_a * float(np.mean(still["current_a"]) / np.mean(still["force_n"]))
    return Delivered(float(np.mean(steady["winding_c"])), damping, gain)


def deviation_pct(moments: list[Delivered]) -> float:
    """Return the largest deviation of damping or torque gain from those of the first moment."""
    first = moments[0]
    shares = [one.active_damping_ns_per_m / first.active_damping_ns_per_m for one in moments]
    shares += [one.torque_gain / first.torque_gain for one in moments]
    return 100.0 * max(abs(share - 1.0) for share in shares)


def measure() -> Iterator[Figure]:
    """Yield `thermal_delivered_pct`, with that of an uncompensated board for comparison."""
    found = {}
    for lacks in ((), ("resistance",)):
        found[lacks] = list(flown(*device(lacks), CYCLES))
    own = found[()]
    without = deviation_pct(found["resistance",])
    name = "thermal_delivered_pct"
    note = f"from {own[0].winding_c:.0f} to {own[-1].winding_c:.0f} degC; without {without:.1f} %"
    yield compared(name, TARGETS[name], deviation_pct(own), "%", without, note)
