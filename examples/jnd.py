"""Just-noticeable difference of stiffness: two springs in sequence, which one was stiffer?

A two-down, one-up staircase converges to the difference that is recognised in 71 % of the trials.
Every presentation is a row of jnd.csv, joined to telemetry by revision and tick. Press the handle,
answer 1 or 2, and take your time. With --simulated, an observer with a just-noticeable difference
of 12 % answers.
"""

import argparse
from math import erf, sqrt
from pathlib import Path

import numpy as np
from connect import arguments, connected

from hapticd import Staircase
from hapticd.client.design import Condition, Table, pairs

REFERENCE_N_PER_M = 200.0
JUST_NOTICEABLE = 0.12  # of the simulated observer, at 71 % right


def simulated(share: float, random: np.random.Generator) -> bool:
    """Return whether an observer recognises a difference of `share`, with a chance level of one
    half.
    """
    noticed = 0.5 * (1.0 + erf(0.5545 * share / JUST_NOTICEABLE / sqrt(2.0)))
    return bool(random.random() < noticed)


def main(asked: argparse.Namespace, path: Path) -> float:
    """Return the just-noticeable difference as a share of the reference."""
    random = np.random.default_rng(1)
    staircase = Staircase(0.5)  # a share of the reference
    reference = Condition("reference", {"K": REFERENCE_N_PER_M})
    number = 0
    with (
        connected(asked, "jnd") as device,
        device.lease("environment", at_end="disable", keep_alive=True) as lease,
        Table(path, ("answer", "right", "share")) as table,
    ):
        device.enable()
        while not staircase.finished:
            share = staircase.level
            stiffer = Condition("stiffer", {"K": REFERENCE_N_PER_M * (1.0 + share)})
            pair = pairs(reference, stiffer, 2, seed=number)[0]
            for condition in pair:
                table.begin(device.set(**condition.settings, ramp_s=0.05), condition)
                lease.sleep(asked.pause)
            truth = 1 + pair.index(stiffer)
            if asked.simulated:
                answer = truth if simulated(share, random) else 3 - truth
            else:
                answer = int(input("which one was stiffer, 1 or 2? "))
            table.answer(answer=answer, right=answer == truth, share=share)
            staircase.answer(answer == truth)
            number += 1
        device.disable()
    return staircase.threshold


if __name__ == "__main__":
    parser = arguments(__doc__.split("\n")[0])
    parser.add_argument("--simulated", action="store_true", help="no participant")
    parser.add_argument("--pause", type=float, default=2.0, metavar="S", help="at each spring")
    found = main(parser.parse_args(), Path("jnd.csv"))
    print(f"just noticeable: {100.0 * found:.0f} % of {REFERENCE_N_PER_M:g} N/m; see jnd.csv")
