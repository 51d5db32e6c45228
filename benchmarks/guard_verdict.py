"""Stability of environments in passive hands, by the tests' own spectral radius (`whole_tick`).

Some hands are fixed: twenty random networks (`passive_hands`), and lossless ladders of masses, of
springs to the wall and of masses behind a spring. For a suspect environment `coupled.shaking_hand`
proposes another. A proposal is only a candidate: the radius decides.

Limitations: a hand that is not passive (their numbers are all positive), or an environment that
only an unproposed hand of many resonators destabilises. So "safe" means that none of about two
hundred hands destabilises it, and that the best of them was refined.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import minimize
from support.passive_hands import random_hands
from support.whole_tick import (
    NOBODY,
    SETTLED,
    Display,
    PlainHand,
    Point,
    gripping,
    held_mass,
    radius,
)

from hapticd.core.environment import FilterParams
from hapticd.model.coupled import destabilising_hand
from hapticd.model.model import Model

FURTHER = 1.05  # of K, B and M, from the empty environment
RANDOM_HANDS = 20
MASSES_KG = np.geomspace(1e-4, 30.0, 33)
SPRINGS_N_PER_M = np.geomspace(5.0, 5e5, 41)
GRIPS_KG = (0.03, 0.3)
BATCH = 4096  # environments at a time
# without a spring the place is an eigenvalue 1, and the slow motion of a heavy hand is almost a
# second one: rounding moves such a pair by the root of its effect on others. With the place removed
# from the matrix, 13.6 kg under 6.4e-5 N s/m has 1 - 4.7e-9; with it, 1 + 3.6e-8 was found.
FREE = 1.0 + 2e-7


def simple_hands() -> list[PlainHand]:
    """Return lossless hands: a mass, a spring to the wall, a mass behind a spring."""
    masses = [held_mass(float(one)) for one in MASSES_KG]
    springs = [held_mass(0.0, float(one)) for one in SPRINGS_N_PER_M]
    grips = [gripping(mass, float(one)) for mass in GRIPS_KG for one in SPRINGS_N_PER_M[::2]]
    return masses + springs + grips


@dataclass(frozen=True)
class Bench:
    """A device in the tests' model, and the package's model of it, which proposes hands."""

    display: Display
    model: Model

    @cached_property
    def few(self) -> list[PlainHand]:
        """No hand, random ones, and every fifth of the simple ones: for transient environments."""
        return [NOBODY, *simple_hands()[::5], *self.hands[-RANDOM_HANDS:]]

    @cached_property
    def hands(self) -> list[PlainHand]:
        """No hand, the simple ones and random ones."""
        drawn = [
            PlainHand(one.mass_kg, one.damping_ns_per_m, one.stiffness_n_per_m)
            for one in random_hands(RANDOM_HANDS)
        ]
        return [NOBODY, *simple_hands(), *drawn]

    def worst(
        self, points: Sequence[Point], hands: Iterable[PlainHand] | None = None
    ) -> np.ndarray:
        """Return the largest radius (P,) of `points` in any of `hands`."""
        chosen = self.hands if hands is None else list(hands)
        found = np.zeros(len(points))
        for start in range(0, len(points), BATCH):
            part = list(points[start : start + BATCH])
            each = [radius(self.display, part, hand) for hand in chosen]
            found[start : start + BATCH] = np.max(each, axis=0)
        return found

    def proposed(self, point: Point) -> PlainHand | None:
        """Return a hand that may destabilise `point`."""
        if not any(point[:3]):
            return None
        filters = (
            FilterParams(point.velocity_hz, point.velocity_zeta),
            FilterParams(point.acceleration_hz, point.acceleration_zeta),
        )
        found = destabilising_hand(self.model, point[:3], point.level, filters)
        return (
            None
            if found is None
            else PlainHand(found[0].mass_kg, found[0].damping_ns_per_m, found[0].stiffness_n_per_m)
        )

    def shaken(self, point: Point) -> bool:
        """Return whether some hand destabilises `point`, after refining the best simple one."""
        if point.stiffness < 0.0 or grows(point, self.worst([point])[0]):
            return True
        proposed = self.proposed(point)
        if proposed is not None and grows(point, radius(self.display, [point], proposed)[0]):
            return True
        return any(grows(point, self._refined(point, spring)) for spring in (False, True))

    def _refined(self, point: Point, spring: bool) -> float:
        """Return the largest radius in a mass, or a spring to the wall, with an additional tuned
        mass.
        """

        def hand(numbers: np.ndarray) -> PlainHand:
            main, tuned_kg, tuned_hz = np.exp(numbers)
            k = tuned_kg * (2.0 * np.pi * tuned_hz) ** 2
            link = np.array([[k, -k], [-k, k]])
            own = np.array([[main if spring else 0.0, 0.0], [0.0, 0.0]])
            mass = np.array([0.0 if spring else main, tuned_kg])
            return PlainHand(mass, np.zeros((2, 2)), link + own)

        def calm(numbers: np.ndarray) -> float:
            bounded = np.clip(numbers, np.log([1e-5, 1e-6, 1.0]), np.log([1e6, 10.0, 2e3]))
            return -float(radius(self.display, [point], hand(bounded))[0])

        ladder = SPRINGS_N_PER_M if spring else MASSES_KG
        simple = [held_mass(0.0, one) if spring else held_mass(one) for one in ladder]
        best = ladder[int(np.argmax([radius(self.display, [point], one)[0] for one in simple]))]
        starts = [np.log([best, 1e-4, hz]) for hz in (60.0, 300.0, 900.0)]
        found = [
            minimize(calm, one, method="Nelder-Mead", options={"maxiter": 80}) for one in starts
        ]
        return max(-float(one.fun) for one in found)

    def unsafe(self, points: Sequence[Point], ends: Sequence[Point]) -> list[Point]:
        """Return those of `points` that are unstable in one of a few hands, and those of `ends`
        that are unstable in any, or in the hand that destabilises the point 5 % further out.
        """
        found = _ringing(points, self.worst(points, self.few))
        found += _ringing(ends, self.worst(ends))
        for point in ends:
            hand = self.proposed(point.scaled(FURTHER))
            if hand is not None and grows(point, radius(self.display, [point], hand)[0]):
                found.append(point)
        return found


def grows(point: Point, found: float) -> bool:
    """Return whether a radius of `found` at `point` is more than rounding."""
    return found > (FREE if point.stiffness == 0.0 else SETTLED)


def _ringing(points: Sequence[Point], worst: np.ndarray) -> list[Point]:
    return [point for point, found in zip(points, worst, strict=True) if grows(point, found)]
