"""Attacks on the force itself, in virtual time, judged by the force of the simulated motor.

`force_path` runs the flights of `benchmarks.attack`. `frames_out` gives hostile frames to the
simulated board and to the reference firmware in C, which have to behave the same. `dead_servo` ends
a servo at a random moment with force on. No frame comes any more, so the board has to remove the
force and keep the damping for as long as docs/safety.md promises.
"""

from random import Random

from benchmarks.attack import fly
from hapticd.mailbox.layout import Command, Value
from hapticd.model.params import HandParams, TouchParams
from hapticd.model.step import SUBSTEPS_PER_TICK
from hapticd.run.lockstep import LockStep
from hapticd.sim.axis import DAMPING_HOLD_S, DAMPING_RELEASE_S
from support.attacks.rows import Losses, Outcome
from support.boards import board_params
from support.firmware_board import FirmwareBoard
from support.hostile import Tally, compare_boards
from support.models import servo_params

CASE_BYTES = 4000
WATCHDOG_TICKS = 20
ENABLE_TICKS = 550
RELEASED_TICKS = round(1000 * (DAMPING_HOLD_S + DAMPING_RELEASE_S))
HAND = HandParams("hold", stiffness_n_per_m=300.0, damping_ns_per_m=3.0, tremor_m=0.002)


def force_path(times: int, seed: int) -> Outcome:
    """`times` ticks of flights with commands, faults and traits at random."""
    losses = Losses()
    ticks = forced = 0
    number = seed
    while ticks < times:
        found = fly(number)
        number += 1
        ticks += found.ticks
        forced += found.forced
        for one in found.violations:
            losses.add(f"seed {found.seed}: {one}")
    return losses.outcome(ticks, under_force_percent=100.0 * forced / ticks)


def frames_out(times: int, seed: int) -> Outcome:
    """`times` frames, to both boards."""
    losses = Losses()
    tally = Tally()
    number = seed
    while tally.frames < times and losses.count == 0:
        try:
            compare_boards(Random(number).randbytes(CASE_BYTES), FirmwareBoard, tally)
        except AssertionError as error:
            losses.add(f"seed {number}: {str(error)[:300]}")
        number += 1
    refused = 100.0 * tally.refused / max(1, tally.frames)
    return losses.outcome(tally.frames, refused_percent=refused)


def dead_servo(times: int, seed: int) -> Outcome:
    """`times` servos that die."""
    losses = Losses()
    for number in range(times):
        try:
            _die(Random(seed + number))
        except AssertionError as error:
            losses.add(f"seed {seed + number}: {error}")
    return losses.outcome(times)


def _die(random: Random) -> None:
    """AssertionError where the board breaks a promise."""
    board = board_params(
        watchdog_ms=float(WATCHDOG_TICKS),
        seed=random.randrange(1000),
        touch=TouchParams(hands=(HAND,)),
    )
    with LockStep(servo_params(), board, keep=False) as stack:
        stack.run(5)
        environment = {Value.STIFFNESS: random.uniform(50.0, 600.0), Value.VIRTUAL_DAMPING: 1.0}
        stack.do(Command.SET, environment)
        damping = {Value.ACTIVE_DAMPING: random.uniform(0.5, 5.0), Value.ACTIVE_DAMPING_ON: 1.0}
        stack.do(Command.DAMPING, damping)
        stack.do(Command.ENABLE)
        stack.run(random.randrange(ENABLE_TICKS, 2 * ENABLE_TICKS))
        axis = stack.backend._port._axis  # type: ignore[attr-defined]
        held = axis.damping_n
        assert axis.force_n != 0.0, "no force to lose"
        for tick in range(WATCHDOG_TICKS + RELEASED_TICKS + 10):
            axis.run_to(axis.now + SUBSTEPS_PER_TICK)
            if tick > WATCHDOG_TICKS + 1:
                assert axis.force_n == 0.0, f"{axis.force_n} N after {tick} ticks"
            if tick < WATCHDOG_TICKS + 1000 * DAMPING_HOLD_S:
                assert axis.damping_n == held, f"{axis.damping_n} N s/m after {tick} ticks"
        assert axis.damping_n == 0.0, f"{axis.damping_n} N s/m at the end"
