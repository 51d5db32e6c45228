"""Attacks on the life of a request past the guard: the event that ends it, and whether it is still
executed later.

Each attack draws one value of each of its features, in rotation, so that all are equally frequent.
It plays one life at random moments on a fresh `Stand`. Most have a control, which is the same
without the attack: in it the motor has to push.

Limitations: a feature must decide something; the counts would grow without that too.
"""

from collections import Counter
from collections.abc import Callable
from itertools import product
from math import prod
from random import Random
from typing import NamedTuple

from support.attacks import lifecycle_requests, lifecycle_servo
from support.attacks.rows import LEAST, Losses, Outcome, Row
from support.attacks.stand import NOTHING, STRICT, WORKER, Chosen

COUNTER = "lives in which the simulated motor did otherwise, and controls without force"
SHARES = 4  # parts of a whole run, one process each


class Attack(NamedTuple):
    """One row; `play` raises where something happens that must not."""

    name: str
    does: str
    expected: str
    features: dict[str, tuple[str, ...]]
    play: Callable[[Chosen, Random], None]

    def run(self, times: int, seed: int) -> Outcome:
        """`times` lives, from number `seed` on."""
        losses = Losses()
        came: Counter[str] = Counter()
        combinations = list(product(*self.features.values()))
        for number in range(seed, seed + times):
            values = combinations[number % len(combinations)]
            came.update(values)
            try:
                self.play(dict(zip(self.features, values, strict=True)), Random(number))
            except Exception as error:  # a servo that ends by it is a loss too
                losses.add(f"life {number}, {', '.join(values)}: {repr(error)[:200]}")
        return Outcome(times, losses.count, tuple(losses.found), came=came)

    def row(self) -> Row:
        """Return the row, with so many lives that every value occurs at least LEAST times."""
        sizes = [len(values) for values in self.features.values()]
        times = -(-LEAST * max(sizes) // prod(sizes)) * prod(sizes)
        part = -(-times // SHARES)
        does, expected = self.does, self.expected
        return Row(self.name, does, expected, COUNTER, "lives", times, prod(sizes), self.run, part)


ATTACKS = (
    Attack(
        "enable-in-stages",
        "an enable that waits for its damping; then another request, or its connection leaves",
        "force does not come later",
        {"end": (*lifecycle_requests.ENDS, "leave", NOTHING), "worker": WORKER},
        lifecycle_requests.enable_in_stages,
    ),
    Attack(
        "gateway-stands-still",
        "an enable is asked, and the gateway stands still for 8 to 20 s",
        "it is not carried out",
        {"where": ("verdict on its line", "stage waits", NOTHING), "worker": WORKER},
        lifecycle_requests.gateway_stands_still,
    ),
    Attack(
        "bounded-push",
        "a push with an end; meanwhile the gateway dies, another comes, the worker falls silent",
        "it ends at its tick",
        {"after": ("gateway gone", "another gateway", "worker silent", "none"), "policy": STRICT},
        lifecycle_servo.bounded_push,
    ),
    Attack(
        "measuring-lease",
        "a change scheduled without a verdict, under a measuring lease, which then ends",
        "it does not come into force under a strict policy",
        {"end": ("release", "leave", NOTHING), "sent": ("apart", "together"), "worker": WORKER},
        lifecycle_requests.measuring_lease,
    ),
    Attack(
        "former-gateway",
        "a change scheduled through a gateway that dies; the next one has a strict policy",
        "it does not come into force",
        {"place": ("first command", "later"), "policy": (*STRICT, NOTHING), "worker": WORKER},
        lifecycle_servo.former_gateway,
    ),
    Attack(
        "policy-made-strict",
        "the policy is made strict between the posting and the answer of a scheduled change",
        "the change does not come into force",
        {"policy": (*STRICT, NOTHING), "before": ("off", "warn"), "worker": WORKER},
        lifecycle_requests.policy_made_strict,
    ),
    Attack(
        "gateway-beside-servo",
        "changes requested from a strict gateway just started with a running servo",
        "no change comes into force before it has read 500 records",
        {"what": ("enable", "push", "damping"), "worker": WORKER},
        lifecycle_requests.gateway_beside_servo,
    ),
    Attack(
        "mute-perturbation",
        "a perturbation asked for while frames are lost, or the board withholds torque",
        "it does not play",
        {"while": ("frames lost", "stop behind lost frames", "torque withheld", NOTHING),
         "worker": WORKER},
        lifecycle_servo.mute_perturbation,
    ),
    Attack(
        "client-numbers",
        "the first client of a new gateway meets the remains of the first client of the former",
        "another's schedule, or stop, is not its own",
        {"left": ("schedule", "stop", NOTHING), "worker": WORKER, "policy": ("warn", "refuse")},
        lifecycle_servo.client_numbers,
    ),
    Attack(
        "masks",
        "ENABLE and WITHHOLD whose mask is not a number, also after lost slots, under `refuse`",
        "the servo goes on: force stays or comes, and STOP works",
        {"kind": ("ENABLE", "WITHHOLD"), "mask": ("nan", "inf", "-inf"),
         "state": ("enabled", "disabled"), "slots": (lifecycle_servo.LOST, "no slot lost"),
         "worker": WORKER},
        lifecycle_servo.masks,
    ),
    Attack(
        "dead-gateways-ring",
        "a gateway dies with an enable or a change in the ring; another beats, at once or later",
        "it brings no force",
        {"left": ("enable", "enable and a pause", "push", NOTHING), "worker": WORKER},
        lifecycle_servo.dead_gateways_ring,
    ),
    Attack(
        "closed-connection",
        "a connection closes while its requests wait for the guard, for their turn, or for the"
        " servo",
        "they are not carried out",
        {"what": ("enable", "push"), "policy": ("warn", "refuse"), "worker": WORKER,
         "place": ("guard", "server", "ring", NOTHING)},
        lifecycle_requests.closed_connection,
    ),
)  # fmt: skip
