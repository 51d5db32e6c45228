"""Fly a million ticks of the whole stack with noise on; print by how many kB the private memory grew after the first."""

import numpy as np
from models import board_params, servo_params

from hapticd.assembly.lockstep import LockStep
from hapticd.mailbox.layout import Command, Value

WARM_UP, TICKS = 100_000, 1_000_000


def private_kb() -> int:
    with open("/proc/self/smaps_rollup") as rollup:
        return sum(int(line.split()[1]) for line in rollup if line.startswith("Private"))


with LockStep(servo_params(), board_params(), keep=False) as stack:
    stack.run(5)
    stack.do(Command.SET, {Value.STIFFNESS: 100.0, Value.DAMPING: 1.0, Value.MASS: 0.01})
    stack.do(Command.ENABLE)
    stack.load_waveform(np.random.default_rng(3).integers(-3000, 3001, 8000).tolist())
    stack.do(Command.PERTURB_START, {Value.SAMPLES: 8000.0, Value.LOOP: 1.0})
    stack.run(WARM_UP)
    before = private_kb()
    stack.run(TICKS)
    print(private_kb() - before, stack.loop.tick, stack.loop.state[12].state.name)
