"""Random passive hands over wide logarithmic ranges: grips, arms, resonators, creep, meshes; also
lossless and massless ones.

Springs connect every node to the others, so that a hand as a whole may drift, but no part of it.
"""

import numpy as np

from hapticd.model.coupled import Hand

GROUND = -1  # number of the node that is the wall


class Network:
    """A hand under construction: nodes and their connections; `GROUND` is the wall."""

    def __init__(self, mass_kg: float = 0.0) -> None:
        self._masses = [mass_kg]
        self._joints: list[tuple[int, int, float, float]] = []

    def node(self, mass_kg: float = 0.0) -> int:
        """Add a node of that mass and return its number."""
        self._masses.append(mass_kg)
        return len(self._masses) - 1

    def join(
        self, one: int, other: int, stiffness_n_per_m: float = 0.0, damping_ns_per_m: float = 0.0
    ) -> None:
        """Put a spring and a damper side by side between two nodes."""
        self._joints.append((one, other, stiffness_n_per_m, damping_ns_per_m))

    def hand(self) -> Hand:
        """Return the hand that was built. AnalysisError as `Hand`."""
        size = len(self._masses)
        stiffness, damping = np.zeros((2, size, size))
        for one, other, spring, damper in self._joints:
            across = np.zeros(size)
            across[[node for node in (one, other) if node != GROUND]] = (1.0, -1.0)[
                : 2 - (one, other).count(GROUND)
            ]
            stiffness += spring * np.outer(across, across)
            damping += damper * np.outer(across, across)
        return Hand(np.array(self._masses), damping, stiffness)


MASS_KG = (1e-5, 30.0)
SPRING_N_PER_M = (1e-1, 1e6)
DAMPER_NS_PER_M = (1e-4, 1e3)
TIME_S = (1e-5, 10.0)
MODE_HZ = (0.3, 2000.0)
LOSS = (1e-5, 3.0)


class Draw:
    """A hand from a random generator."""

    def __init__(self, random: np.random.Generator) -> None:
        self.random = random
        self.network = Network(self.size(MASS_KG, absent=0.5))

    def size(self, bounds, absent=0.0):
        """Log-uniform, or 0 with probability `absent`."""
        return (
            0.0
            if self.random.random() < absent
            else float(np.exp(self.random.uniform(*np.log(bounds))))
        )

    def link(self, one, other, loose=0.0):
        """Add a spring and a damper; half of them with a parallel Maxwell arm."""
        self.network.join(
            one,
            other,
            self.size(SPRING_N_PER_M, loose),
            self.size(DAMPER_NS_PER_M, max(loose, 0.2)),
        )
        if self.random.random() < 0.5:
            self.arm(one, other)

    def arm(self, one, other):
        """Spring and damper in a row, a massless node between them."""
        stiffness = self.size(SPRING_N_PER_M)
        middle = self.network.node()
        self.network.join(one, middle, stiffness)
        self.network.join(middle, other, 0.0, stiffness * self.size(TIME_S))


def grip(draw):
    draw.network.join(0, GROUND, draw.size(SPRING_N_PER_M, 0.3), draw.size(DAMPER_NS_PER_M, 0.3))


def chain(draw):
    """Fingertip, finger, wrist, arm: ends at the wall or free."""
    last = 0
    for _ in range(draw.random.integers(1, 5)):
        new = draw.network.node(draw.size(MASS_KG))
        draw.link(last, new)
        last = new
    if draw.random.random() < 0.7:
        draw.link(last, GROUND)


def modes(draw):
    """One to six resonators side by side, down to a damping ratio of 1e-5 and to none."""
    grip(draw)
    for _ in range(draw.random.integers(1, 7)):
        mass = draw.size(MASS_KG)
        rate = 2.0 * np.pi * draw.size(MODE_HZ)
        draw.network.join(
            0, draw.network.node(mass), mass * rate**2, 2.0 * mass * rate * draw.size(LOSS, 0.2)
        )


def creep(draw):
    """A ladder of relaxations."""
    grip(draw)
    for _ in range(draw.random.integers(1, 5)):
        draw.arm(0, GROUND)


def mesh(draw):
    """Two to five masses, joined at random."""
    count = int(draw.random.integers(2, 6))
    for _ in range(1, count):
        new = draw.network.node(draw.size(MASS_KG))
        draw.link(new, int(draw.random.integers(new)))
    for _ in range(count):
        one, other = draw.random.choice(np.arange(GROUND, count), 2, replace=False)
        draw.network.join(
            int(one), int(other), draw.size(SPRING_N_PER_M, 0.3), draw.size(DAMPER_NS_PER_M, 0.3)
        )


KINDS = (grip, chain, modes, creep, mesh)


def random_hands(count: int, seed: int = 1) -> list[Hand]:
    """`count` of them, the kinds in turn; the same for the same seed."""
    found = []
    for place in range(count):
        draw = Draw(np.random.default_rng((seed, place)))
        KINDS[place % len(KINDS)](draw)
        found.append(draw.network.hand())
    return found
