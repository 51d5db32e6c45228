"""The whole stack on virtual time: CPU of 90 s of an enabled servo with a perturbation, with every
record read.

The yardstick is as many minimal ticks (`bare`). Runs of 10 s and as many minimal ticks take turns;
minimum of each.
"""

import time
from collections.abc import Iterator
from math import pi, sin

from benchmarks import targets
from benchmarks.bare import BareLoop
from benchmarks.figures import Figure, compared
from benchmarks.stand import settings
from benchmarks.tick_reference import yardstick
from benchmarks.worker import BenchError
from hapticd.core.params import ServoParams
from hapticd.mailbox.layout import RECORD, Command, Result, Value
from hapticd.model.params import BoardParams
from hapticd.run.lockstep import LockStep
from hapticd.settings.build import board_params, servo_params

TARGETS = targets.of("lockstep")
SCALED_S = 90
RUN_S = 10
ROUNDS = 9
WAVE = [round(3000 * sin(2 * pi * 20 * index / 4000)) for index in range(4000)]


def measure() -> Iterator[Figure]:
    """Measure the shipped simulated board, a rigid mass."""
    stand = settings()
    board = board_params(stand)
    assert board is not None
    yield lockstep_figure(
        "lockstep_ratio", TARGETS["lockstep_ratio"], servo_params(stand, "bench"), board
    )


def lockstep_figure(name: str, target: str, servo: ServoParams, board: BoardParams) -> Figure:
    """Return the seconds of CPU for 90 s, and of as many minimal ticks."""
    ticks = round(RUN_S * servo.realtime.rate_hz)
    bare = BareLoop(servo.usb, board, yardstick(servo.environment, servo.realtime.rate_hz))
    taken = [(run_cpu_s(servo, board, ticks), bare.cpu_s(ticks)) for _ in range(ROUNDS)]
    ours_s, bare_s = (SCALED_S / RUN_S * min(times) for times in zip(*taken, strict=True))
    return compared(
        name, target, ours_s, "s", bare_s, f"CPU of {SCALED_S} s at {servo.realtime.rate_hz:g} Hz"
    )


def run_cpu_s(servo: ServoParams, board: BoardParams, ticks: int) -> float:
    """Return the CPU time of one run, including its construction and the reading of
    every record.
    """
    begin = time.process_time()
    with LockStep(servo, board) as stack:
        stack.run(10)
        stack.load_waveform(WAVE)
        answers = (
            stack.do(Command.ENABLE),
            stack.do(Command.PERTURB_START, {Value.SAMPLES: len(WAVE), Value.LOOP: 1}),
        )
        records = len(stack.run(ticks)) // RECORD.size
    if records != ticks or any(answer.result is not Result.APPLIED for answer in answers):
        raise BenchError(
            f"the run ended with {records} records of {ticks}, answers"
            f" {[answer.result for answer in answers]}"
        )
    return time.process_time() - begin
