"""Just-noticeable difference of stiffness: two springs after each other, which one was stiffer?

A staircase of two down, one up (Levitt 1971) goes to the difference that 71 % of the answers find.
Every presentation is a row of jnd.csv, joined to telemetry by revision and tick. Press the handle,
answer 1 or 2, and take your time; with --simulated an observer with a just-noticeable difference
of 12 % answers.
"""

import argparse
from math import erf, sqrt
from pathlib import Path

import numpy as np

from hapticd.client import Client
from hapticd.client.design import Condition, Table, pairs

REFERENCE_N_PER_M = 200.0
DOWN = 2  # right answers in a row that make it harder
FACTOR = 1.25  # of the difference, from step to step
REVERSALS = 8
JUST_NOTICEABLE = 0.12  # of the simulated observer, at 71 % right


def simulated(share: float, random: np.random.Generator) -> bool:
    """Whether an observer finds a difference of `share`: right by chance in half the cases."""
    noticed = 0.5 * (1.0 + erf(0.5545 * share / JUST_NOTICEABLE / sqrt(2.0)))
    return bool(random.random() < noticed)


def main(path: Path, observer: bool, pause_s: float) -> float:
    """The just-noticeable difference as a share of the reference."""
    random = np.random.default_rng(1)
    share = 0.5
    right = 0
    turns: list[float] = []
    falling = True
    with (
        Client(name="jnd") as device,
        device.lease("environment", at_end="disable", keep_alive=True) as lease,
        Table(path, ("answer", "right", "share")) as table,
    ):
        device.enable()
        for number in range(1000):
            reference = Condition("reference", {"K": REFERENCE_N_PER_M})
            stiffer = Condition("stiffer", {"K": REFERENCE_N_PER_M * (1.0 + share)})
            pair = pairs(reference, stiffer, 2, seed=number)[0]
            for condition in pair:
                table.begin(device.set(**condition.settings, ramp_s=0.05), condition)
                lease.sleep(pause_s)
            truth = 1 + pair.index(stiffer)
            if observer:
                answer = truth if simulated(share, random) else 3 - truth
            else:
                answer = int(input("which one was stiffer, 1 or 2? "))
            table.answer(answer=answer, right=answer == truth, share=share)
            right = right + 1 if answer == truth else 0
            if right not in (0, DOWN):
                continue
            if falling != (right == DOWN):
                turns.append(share)
                falling = right == DOWN
            if len(turns) == REVERSALS:
                break
            share = share / FACTOR if right == DOWN else share * FACTOR
            right = 0
        device.disable()
    return float(np.exp(np.mean(np.log(turns[2:]))))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--simulated", action="store_true", help="nobody is there")
    parser.add_argument("--pause", type=float, default=2.0, metavar="S", help="at each spring")
    asked = parser.parse_args()
    found = main(Path("jnd.csv"), asked.simulated, asked.pause)
    print(f"just noticeable: {100.0 * found:.0f} % of {REFERENCE_N_PER_M:g} N/m; see jnd.csv")
