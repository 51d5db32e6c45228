"""Random requests through the gateway's command server, in flight: with a hand that would
destabilise the point 5 % further out, and a person who moves.

The sequence of a seed is first run without a board (`guard_requests`). Its last steady environment
determines the hand, a mass on the rotor or a spring to the wall. Then the same client sends the
same requests to the real command server, in front of the servo and a board in that hand. A flight
passes if

    no environment in force in the records is unstable in a few dozen hands, or in this one
    the balance at the motor and the bound of the motion hold (`guard_flight`)
    no fault ends it

Limitations: a wall, whose energy is not in the balance; the requests contain none.
"""

from random import Random
from typing import Any, NamedTuple

import numpy as np
from support.whole_tick import PlainHand, Point, held_mass

from benchmarks.guard_flight import (
    SLACK_J,
    Balance,
    heavy,
    moving,
    plain_servo,
    records,
    rigid_board,
)
from benchmarks.guard_requests import PLAIN, POLICIES, Answering, fly, request
from benchmarks.guard_verdict import FURTHER, Bench, grows
from benchmarks.guarded_stack import CommandServerClient, GuardedStack
from hapticd.mailbox.layout import State
from hapticd.run.lockstep import LockStep

REQUESTS = 8
QUIET_TICKS = 300  # after the last request, without the person
COLUMNS = ("stiffness_n_per_m", "virtual_damping_ns_per_m", "mass_kg")


class Flight(NamedTuple):
    """Result of one flight."""

    seed: int
    points: int  # judged environments in force
    wrong: list[str]


def hand_of(seed: int, judge: Answering, bench: Bench) -> PlainHand:
    """Return the hand of a seed: it destabilises the point 5 % beyond the end of its sequence, if
    any hand does.
    """
    ends = [point for point in fly(seed, judge, plain_servo()).ends if any(point[:3])]
    found = bench.proposed(ends[-1].scaled(FURTHER)) if ends else None
    if found is None:
        return held_mass(0.0, 3000.0)
    # small tuned masses that serve images are left out
    return held_mass(float(found.mass_kg[0]), max(0.0, float(found.stiffness_n_per_m[0].sum())))


def flown(seed: int, judge: Answering, bench: Bench) -> Flight:
    """Return the flight of `seed`."""
    random = Random(f"flight {seed}")
    hand = hand_of(seed, judge, bench)
    arm_n_per_m = float(hand.stiffness_n_per_m[0, 0])
    board = rigid_board(heavy(float(hand.mass_kg[0]), arm_n_per_m))
    with LockStep(plain_servo(), board) as stack:
        balance = Balance(stack, moving(seed, 2.5), arm_n_per_m)
        guarded = GuardedStack(stack, judge, POLICIES[seed % len(POLICIES)])
        client = CommandServerClient(guarded)
        client.ask({}, enable=True)
        client.run(150)
        for _ in range(REQUESTS):
            request(client, random, PLAIN)
            client.run(random.choice((random.randrange(40), random.randrange(500))))
        client.run(QUIET_TICKS)
        found = records(stack)
    points = in_force(found)
    wrong = _ringing(bench, points, hand) + _energies(balance)
    faults = set(found["fault"].tolist()) - {0}
    return Flight(seed, len(points), wrong + [f"fault {number}" for number in sorted(faults)])


def in_force(found: np.ndarray) -> list[Point]:
    """Return the rendered and damped environments of the records, each once; filters have their
    defaults.
    """
    live = found[found["state"] == State.ENABLED]
    scaled = [live["gain"] * live[name] for name in COLUMNS]
    rows = np.stack((*scaled, live["active_damping_effect_ns_per_m"].astype(float)), axis=1)
    distinct = np.unique(rows.round(6), axis=0).tolist()
    return [Point(*row) for row in distinct]


def _ringing(bench: Bench, points: list[Point], hand: PlainHand) -> list[str]:
    if not points:
        return ["never under force"]
    worst = bench.worst(points, [*bench.few, hand])
    found = zip(points, worst, strict=True)
    grown = [(radius, point) for point, radius in found if grows(point, radius)]
    if not grown:
        return []
    radius, point = max(grown)
    return [f"{point} rings, {radius:.7f}"]


def _energies(balance: Balance) -> list[str]:
    found: dict[str, Any] = {"balance": balance.worst_j, "motion": balance.worst_motion_j}
    return [f"{name} {1e3 * one:.1f} mJ" for name, one in found.items() if one > SLACK_J]
