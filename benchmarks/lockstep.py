"""The whole stack on virtual time: CPU seconds for 90 s of an enabled servo with a perturbation, every record read."""

import time
from collections.abc import Iterator
from math import pi, sin
from statistics import median

from benchmarks.figures import Figure, compared
from benchmarks.stand import settings
from benchmarks.worker import BenchError
from hapticd.assembly.lockstep import LockStep
from hapticd.mailbox.layout import RECORD, Command, Result, Value
from hapticd.params import BoardParams, ServoParams
from hapticd.settings.build import board_params, servo_params

TARGETS = {"lockstep_90s_cpu_s": "<= 5"}
FLOWN_S, RUNS = 90, 3
WAVE = [round(3000 * sin(2 * pi * 20 * index / 4000)) for index in range(4000)]


def measure() -> Iterator[Figure]:
    """Median of three flights."""
    stand = settings()
    board, servo = board_params(stand), servo_params(stand, "bench")
    assert board is not None
    spent = median(flight_s(servo, board) for _ in range(RUNS))
    yield compared("lockstep_90s_cpu_s", TARGETS["lockstep_90s_cpu_s"], spent, "s")


def flight_s(servo: ServoParams, board: BoardParams) -> float:
    """CPU time of one flight, its making and every record read included."""
    begin = time.process_time()
    with LockStep(servo, board) as flight:
        flight.run(10)
        flight.load_waveform(WAVE)
        answers = (flight.do(Command.ENABLE), flight.do(Command.PERTURB_START, {Value.SAMPLES: len(WAVE), Value.LOOP: 1}))
        ticks = round(FLOWN_S * servo.realtime.rate_hz)
        flown = len(flight.run(ticks)) // RECORD.size
    if flown != ticks or any(answer.result is not Result.APPLIED for answer in answers):
        raise BenchError(f"the flight ended with {flown} records of {ticks}, answers {[answer.result for answer in answers]}")
    return time.process_time() - begin
