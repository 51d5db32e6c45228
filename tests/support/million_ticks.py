"""Fly a million ticks of the whole stack with noise on, and print the growth of its private
(anonymous) memory in kB after the first. Printed is the smaller growth of the two halves: a leak
grows in both, while pages that the kernel reclaimed earlier may return once.
"""

import numpy as np

from hapticd.mailbox.layout import Command, Value
from hapticd.run.lockstep import LockStep
from support.boards import board_params
from support.models import servo_params

# the records of one block (AT_ONCE ticks) are kept until its end
WARM_UP = 100_000
TICKS = 1_000_000
AT_ONCE = 1000


def anonymous_kb() -> int:
    with open("/proc/self/smaps_rollup") as rollup:
        return sum(int(line.split()[1]) for line in rollup if line.startswith("Anonymous"))


with LockStep(servo_params(), board_params(), keep=False) as stack:
    stack.run(5)
    stack.do(Command.SET, {Value.STIFFNESS: 100.0, Value.VIRTUAL_DAMPING: 1.0, Value.MASS: 0.01})
    stack.do(Command.ENABLE)
    stack.load_waveform(np.random.default_rng(3).integers(-3000, 3001, 8000).tolist())
    stack.do(Command.PERTURB_START, {Value.SAMPLES: 8000.0, Value.LOOP: 1.0})
    for _ in range(WARM_UP // AT_ONCE):
        stack.run(AT_ONCE)
    grown = []
    for _ in range(2):
        before = anonymous_kb()
        for _ in range(TICKS // 2 // AT_ONCE):
            stack.run(AT_ONCE)
        grown.append(anonymous_kb() - before)
    print(min(grown), stack.loop.tick, stack.loop.state[0].plan.state.name)
