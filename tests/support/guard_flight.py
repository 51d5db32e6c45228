"""K = 500 N/m and B = 2 N s/m in the hand that shakes them, with active damping toggled twenty
times.

The command server of the gateway, the guard's judge, the servo, the board and the plant run on
virtual time.
"""

from functools import lru_cache
from random import Random
from typing import Any, NamedTuple

import numpy as np

from benchmarks.guard_attack import shipped_judge
from benchmarks.guard_flight import (
    GRIPPING,
    Balance,
    plain_servo,
    records,
    rigid_board,
    striking,
)
from benchmarks.guarded_stack import GuardedStack
from hapticd.run.lockstep import LockStep

STIFFNESS = 500.0
DAMPING = 2.0
TOGGLES = 20
STRIKES_S = tuple(np.arange(0.4, 12.0, 0.37).tolist())
HELD = ("refuse", "clamp", "follow")
NEAR = 1.5  # bound on the growth of a passive, little damped display at the edge of its set


class Flight(NamedTuple):
    """The result of a flight."""

    replies: list[tuple[str, dict[str, Any], dict[str, Any] | None]]  # request, reply, later event
    balance: Balance
    records: np.ndarray
    hands: list[dict[str, Any]]


@lru_cache(maxsize=4)
def flight(policy: str, rendered: bool = True) -> Flight:
    """Toggled twenty times at random under `policy`."""
    random = Random("toggles")
    asked = []
    with LockStep(plain_servo(), rigid_board(GRIPPING)) as stack:
        balance = Balance(stack, striking(STRIKES_S))
        guarded = GuardedStack(stack, shipped_judge().answer, policy)
        if rendered:
            assert guarded.ask(cmd="damping", value=1.74)["ok"]
            guarded.run(200)
            assert guarded.ask(cmd="set", K=STIFFNESS, B=DAMPING)["ok"]
            guarded.run(100)
        assert guarded.ask(cmd="enable")["ok"]
        guarded.run(400)
        for _ in range(TOGGLES if rendered else 0):
            wanted = random.choice(("on", "off"))
            asked.append((wanted, guarded.send(cmd="damping", value=wanted)))
            guarded.run(random.randrange(20, 300))
        guarded.run(300 if rendered else 4000)
        replies = [(word, guarded.replies[number], guarded.ended(number)) for word, number in asked]
        hands = [one for one in guarded.events if one["kind"] == "guard"]
        return Flight(replies, balance, records(stack), hands)


def passive_m() -> float:
    """Return how far the hand goes without rendered force."""
    return flight("refuse", rendered=False).balance.furthest_m


def verdict(reply: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = reply["guard"] if reply["ok"] else reply["error"]["guard"]
    return found
