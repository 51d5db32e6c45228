"""Samples of a known motion under a law's held force, and the exact work of that force, for tests
of the energy ledger.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from hapticd.protocol.ledger import SAMPLE

Floats = npt.NDArray[np.float64]
T = 1e-3


def sampled(position_m: Floats, force_n: Floats, delay: float) -> npt.NDArray[np.void]:
    """Rows of SAMPLE: a spring's force at `position_m` (n,), sent as it is, late by `delay`."""
    rows = np.zeros(len(position_m), SAMPLE)
    rows["position_m"] = position_m
    for name in ("stiffness_n", "clamped_n", "sent_n"):
        rows[name] = force_n
    rows["periods"] = 1.0
    rows["delay"] = delay
    return in_effect(rows, delay)


def in_effect(rows: npt.NDArray[np.void], delay: float) -> npt.NDArray[np.void]:
    """Return the same rows with the `sent_n` that a board would report for the true
    delay `delay`.
    """
    whole = int(delay)
    sent_at = np.maximum(np.arange(len(rows)) - 1 - whole, 0)
    rows["in_effect_n"] = rows["sent_n"][sent_at]
    rows["since"] = 1.0 - (delay - whole)
    return rows


def exact_work(motion: Callable[[Floats], Floats], force_n: Floats, delay: float) -> Floats:
    """Work [J] up to each sample of a held force along `motion`, integrated in closed form; the
    first force has been there for ever.
    """
    at = np.arange(len(force_n)) * T
    done = np.zeros(len(force_n))
    for place in range(-int(delay) - 1, len(force_n)):
        begin = (place + delay) * T
        end = (place + 1 + delay) * T
        ways = motion(np.clip(end, 0.0, at)) - motion(np.clip(begin, 0.0, at))
        done += force_n[max(place, 0)] * ways
    return done
