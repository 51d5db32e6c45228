"""Every counter begins just below its wrap and is flown over it: nothing else may change.

A flight with commands, ramps, damping, a perturbation and lost frames is flown from 0 and from just
below a wrap; all columns but those that count are the same, and those that count differ by what
they began with. The probe's index, which the servo hands on as it is, has its wrap in
`test_gateway_telemetry`, the 16 bits of encoder and index offset in `test_wire_session`.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from support.boards import board_params
from support.gateway_rig import CommandServerRig
from support.models import servo_params

from hapticd.mailbox.layout import TELEMETRY, Command, Result, Value
from hapticd.model.params import BoardParams, InjectionParams
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import SETTLED

DTYPE = np.dtype([tuple(field) for field in TELEMETRY])
LOST = (InjectionParams("drop_in", tick=900, count=2), InjectionParams("drop_out", tick=950))
WORD = 1 << 32
BEFORE = 768  # ticks, changes or whatever is counted, before the wrap
TICKS = 1600
FRAMES = ("in_frame", "out_frame")  # they hold counters of the wire, and a CRC over them
Records = Any


def flown(begin: Callable[[LockStep], None] = lambda stack: None, **board: Any) -> Records:
    """The flight, after `begin` has set a counter."""
    params: BoardParams = board_params(injections=LOST, **board)
    with LockStep(servo_params(), params) as stack:
        stack.run(5)
        begin(stack)
        stack.blocks.clear()
        stack.do(
            Command.SET, {Value.STIFFNESS: 100.0, Value.VIRTUAL_DAMPING: 1.0, Value.MASS: 0.01}
        )
        stack.do(Command.ENABLE)
        stack.load_waveform(np.random.default_rng(3).integers(-3000, 3001, 800).tolist())
        stack.do(Command.PERTURB_START, {Value.SAMPLES: 800.0, Value.LOOP: 1.0})
        for number in range(8):
            stack.do(Command.SET, {Value.STIFFNESS: 50.0 * number, Value.RAMP_S: 0.05})
            level = {Value.ACTIVE_DAMPING: 1.74, Value.ACTIVE_DAMPING_ON: float(number % 2)}
            stack.do(Command.DAMPING, level)
            stack.run(TICKS // 8)
        stack.do(Command.STOP)
        stack.run(60)
        return np.frombuffer(b"".join(stack.blocks), DTYPE)


def same(first: Records, second: Records, *but: str) -> None:
    """All columns but those named are the same."""
    assert len(first) == len(second)
    for name in set(DTYPE.names or ()) - {*but, *FRAMES}:
        assert np.array_equal(first[name], second[name]), name


def with_ticks(stack: LockStep) -> None:
    """The tick of the servo, as after 49 days at 1 kHz."""
    shift = WORD - BEFORE  # whole periods of 256, by which the loop counts as well
    stack.loop.tick += shift
    stack._tail += shift
    stack.mailbox.publish_head(0, stack.loop.tick)


def with_revisions(stack: LockStep) -> None:
    """Of what is asked, and of the environment: a few changes before they wrap."""
    settled = stack.loop.state[SETTLED]
    plan = settled.plan._replace(revision=WORD - 5, environment_revision=WORD - 5)
    state = list(stack.loop.state)
    state[SETTLED] = replace(settled, plan=plan)
    stack.loop.state = tuple(state)


def test_change_may_name_the_environment_that_is_in_force_over_its_wrap() -> None:
    """Answers, records and what a change names agree, or it would be refused for ever."""
    with LockStep(servo_params(), board_params()) as stack:
        stack.run(5)
        with_revisions(stack)
        for number in range(9):
            answer = stack.do(Command.SET, {Value.STIFFNESS: 10.0 + number, Value.RAMP_S: 0.0})
            told = answer.effective[Value.ENVIRONMENT_REVISION]
            record = np.frombuffer(stack.run(1), DTYPE)[-1]
            assert told == record["environment_revision"]
            assert answer.revision == record["revision"]
            named = {Value.STIFFNESS: 5.0, Value.ENVIRONMENT_REVISION: told}
            assert stack.do(Command.SET, named).result == Result.APPLIED


def test_gateway_follows_the_revisions_over_their_wrap(tmp_path: Path) -> None:
    """It knows what is in force, tells the revision of the record, and takes `if_rev`."""
    rig = CommandServerRig(tmp_path)
    rig.servo.revision = WORD - 4
    rig.servo.values[Value.ENVIRONMENT_REVISION] = float(WORD - 4)
    rig.run(1)
    rig.start_gateway()
    rig.run(2)
    for number in range(8):
        expected = (WORD - 4 + number) % WORD
        reply = rig.ask(cmd="set", K=5.0 + number, if_rev=expected)
        assert reply["ok"], reply
        assert reply["rev"] == (expected + 1) % WORD
        rig.run(2)
        assert rig.guard.in_force.known
        assert not rig.guard.in_force.ahead_of_answers
        assert rig.view.revision == rig.view.record["revision"]
