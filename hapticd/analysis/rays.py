"""Where rays from inside a set in the unit box leave it: the set's boundary by yes and no alone,
for `search`.

Directions lie evenly on the sphere (Fibonacci spiral: Swinbank and Purser 2006); each ray is halved
between its start, which is inside, and the box's end. What would break it: a set that a ray leaves
twice; only one of its exits is found.
"""

from collections.abc import Callable

import numpy as np

from hapticd.analysis.arrays import Flags, Floats

N_RAYS = 400
N_SAMPLES = 3000  # random points that find the middle and the volume
_HALVINGS = 12
_EDGE = 0.999  # of the way to the end of the box


def boundary(holds: Callable[[Floats], Flags], middle: Floats) -> tuple[Floats, Flags]:
    """Where rays from `middle` (3,) leave the set `holds`: (N_RAYS, 3) in the unit box, and
    which reach the box's end inside.
    """
    rays = directions()
    with np.errstate(divide="ignore"):
        to_end = np.where(
            rays > 0.0, (1.0 - middle) / rays, np.where(rays < 0.0, -middle / rays, np.inf)
        ).min(axis=1)
    low = np.zeros(N_RAYS)
    high = _EDGE * to_end
    ends = holds(middle + rays * high[:, None])
    low = np.where(ends, high, low)
    low, high = halved(lambda share: holds(middle + rays * share[:, None]), low, high, _HALVINGS)
    return middle + rays * (0.5 * (low + high))[:, None], ends


def halved(
    holds: Callable[[Floats], Flags], low: Floats, high: Floats, times: int
) -> tuple[Floats, Floats]:
    """Intervals (n,) about the edge of what holds at `low` and not at `high`, halved so many
    `times`; `holds` takes a value in each of them.
    """
    for _ in range(times):
        half = 0.5 * (low + high)
        inside = holds(half)
        low = np.where(inside, half, low)
        high = np.where(inside, high, half)
    return low, high


def directions() -> Floats:
    """Unit vectors (N_RAYS, 3)."""
    at = np.arange(N_RAYS) + 0.5
    down = np.arccos(1.0 - 2.0 * at / N_RAYS)
    around = np.pi * (1.0 + np.sqrt(5.0)) * at
    return np.column_stack(
        (np.cos(around) * np.sin(down), np.sin(around) * np.sin(down), np.cos(down))
    )


def samples() -> Floats:
    """Random points (N_SAMPLES, 3) of the unit box, always the same."""
    return np.random.default_rng(1).random((N_SAMPLES, 3))


def distance(one: Floats, other: Floats) -> Floats:
    """From each of `one` (N, 3) to the nearest of `other` (n, 3)."""
    return np.asarray(np.sqrt(((one[:, None] - other) ** 2).sum(axis=2)).min(axis=1))
