"""`make hands`: random passive hands on environments at the edge of the guard's safe set.

    python tests/hands.py                           5,000 hands for each of 300 environments
    python tests/hands.py --environments 30 --hands 100 --seed 7
    python tests/hands.py --share 2                 beyond the edge, where some hands destabilise
    python tests/hands.py --begin 4                 go on with the fifth device

Each environment is a direction in K, B, M at 0.999 of its edge. Ten of them are on one device with
a narrow mode. Hands are the networks of masses, springs and dampers of support.passive_hands, with
chains and meshes of up to five masses. A violation is a growing loop: a spectral radius above 1 by
more than rounding. Ticks are computed in double precision by scipy; from SUSPECT on, and for every
50th hand, they are computed again in the extended precision of the package. Prints a line of JSON
for each device, on stderr, and one for all; the exit code is 1 for a violation.
"""

import argparse
import json
import sys
import time
from unittest import mock

import numpy as np
import scipy.linalg
from support.narrow_modes import directions, drawn, edge
from support.passive_hands import random_hands

from hapticd.model import discrete
from hapticd.model.bases import Conditions, Theorem
from hapticd.model.coupled import GROWS, held_by
from hapticd.model.loop import PAPER_FILTERS, radii, tick_of

INSIDE = 0.999  # of an edge
# of the largest entry of a tick: a hand of 1e9 N/m that nothing holds pushes with 2e-6 N/m
ROUNDING = 1e-14
SUSPECT = 1.0 + 1e-10
CHECKED = 50  # every so manieth hand
EACH = 10  # environments of one device


def edges(seed, count, share):
    """The model of a device and environments (n, 3) at a share of its edges, at most `count`."""
    device = drawn(seed)
    model = device.model()
    theorem = Theorem(model)
    at = Conditions(0.0, PAPER_FILTERS, device.delay_periods, 0.0)
    ways = directions(seed, count)
    shares = [edge(lambda points: theorem.safe(points, at), way) for way in ways]
    found = [share * far * way for far, way in zip(shares, ways, strict=True) if 0 < far < np.inf]
    return model, np.array(found).reshape(-1, 3)


def quick(model, points):
    """Radii (N,) of the ticks of `model` under `points`, by a faster exponential."""
    with mock.patch.object(discrete, "expm", scipy.linalg.expm):
        return radii(tick_of(model), points)


def played(environments, count, seed, share, begin=0):
    """Environments, pairs, violations with radius, the largest radius, the largest limit of a
    radius, and the largest error of the quick radii.
    """
    hands = random_hands(count, seed)
    sums = dict.fromkeys(("environments", "pairs", "again", "radius", "limit", "error"), 0)
    violations = []

    def most(name, value):
        sums[name] = max(sums[name], float(value))

    for device in range(begin, -(-environments // EACH)):
        model, points = edges(1000 * seed + device, min(EACH, environments - device * EACH), share)
        sums["environments"] += len(points)
        for place, hand in enumerate(hands if len(points) else ()):
            held = held_by(model, hand)
            found = quick(held, points)
            sums["pairs"] += found.size
            if found.max() <= SUSPECT and place % CHECKED:
                most("radius", found.max())
                continue
            tick = tick_of(held)
            exact = radii(tick, points)
            limit = max(GROWS, 1.0 + ROUNDING * np.abs(tick.base).max())
            sums["again"] += found.size
            most("radius", exact.max())
            most("limit", limit)
            most("error", np.abs(exact - found).max())
            violations += [
                {"device": device, "hand": place, "point": points[at].tolist(), "radius": exact[at]}
                for at in np.flatnonzero(exact > limit)
            ]
        print(json.dumps({**sums, "violations": len(violations)}), file=sys.stderr, flush=True)
    worst = sorted(violations, key=lambda one: -one["radius"])[:20]
    return {**sums, "violations": len(violations), "worst": worst}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--environments", type=int, default=300)
    parser.add_argument("--hands", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--share", type=float, default=INSIDE, help="of the edge")
    parser.add_argument("--begin", type=int, default=0, help="first device")
    asked = parser.parse_args()
    begin_s = time.process_time()
    found = played(asked.environments, asked.hands, asked.seed, asked.share, asked.begin)
    spent_s = time.process_time() - begin_s
    print(json.dumps({**found, "pairs_per_s": round(found["pairs"] / spent_s)}))
    return int(found["violations"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
