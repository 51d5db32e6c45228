"""A hand moves the handle to and fro against a weak spring: force and velocity that differ.

With the spring K the commanded force follows the position and the velocity is a quarter of a cycle
ahead of it, so what is proportional to one is told from what is proportional to the other. Nothing
pushes by itself: a handle that is let go comes to rest.

The signals are means over WINDOW periods, by Simpson's rule; that of the velocity is exact, as the
encoder's difference (see `signal.delivered`). At the few hertz of a hand, delays and lags of a
millisecond turn a force by a hundredth.

What would break it: a hand that does not move (there is nothing to see then), a board whose spring
is not passive with that of SPRING.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.client.blocks import Records
from hapticd.client.client import Client
from hapticd.core.arrays import Floats
from hapticd.core.environment import Environment
from hapticd.rig.experiment import collect, rendering, require_force
from hapticd.rig.hand import Ask, Request
from hapticd.rig.result import Finding
from hapticd.signal.delivered import SIMPSON, WINDOW

SPRING = Environment(100.0, 0.5)
RAMP_S = 1.0
PIECE_S = 1.0
LEAST_N = 0.02  # rms, of a force: less says nothing
WAITS = "a hand moves against a spring"  # before that, it looks like a wrong sign
RAW = (
    "tick",
    "position_m",
    "force_n",
    "current_a",
    "emf_velocity_m_per_s",
    "active_damping_ns_per_m",
    "active_damping_effect_ns_per_m",
    "resistance_count",
    "winding_c",
)


class Means(NamedTuple):
    """Means over windows of a piece, (n,) each."""

    force_n: Floats  # commanded
    motor_n: Floats  # by the current
    seen_m_per_s: Floats  # velocity by the back-EMF
    velocity_m_per_s: Floats  # by the encoder
    faster_m_per_s2: Floats  # acceleration, by the encoder


def means_of(records: Records, n_per_a: float, rate_hz: float) -> Means:
    """The means of consecutive `records`, with the force of an ampere."""
    places = np.arange(0, len(records) - WINDOW, WINDOW)[:, None] + np.arange(WINDOW + 1)
    x = records["position_m"].astype(np.float64)[places]

    def mean(name: str) -> Floats:
        found: Floats = records[name].astype(np.float64)[places] @ SIMPSON
        return found

    faster_m = (x[:, -1] - x[:, -2]) - (x[:, 1] - x[:, 0])
    return Means(
        mean("force_n"),
        n_per_a * mean("current_a"),
        mean("emf_velocity_m_per_s"),
        (x[:, -1] - x[:, 0]) * rate_hz / WINDOW,
        faster_m * rate_hz**2 / (WINDOW - 1),
    )


def joined(pieces: Sequence[Means]) -> Means:
    """All windows of `pieces`."""
    return Means(*map(np.concatenate, zip(*pieces, strict=True)))


def unknown_ampere(device: Mapping[str, Any]) -> list[Finding]:
    """That nobody measured the force of an ampere; nothing if `device` of a hello has it."""
    if device["motor_n_per_a"]:
        return []
    remedy = "`hapticd rig motor --winding` measures it where the board reports its current"
    return [Finding("the device file does not say the force of an ampere", "not done", remedy)]


def moved(
    bench: Client, ask: Ask, seconds: float, seen: Callable[[Records], bool] = lambda new: True
) -> list[Records]:
    """Pieces of PIECE_S while a hand moves the handle for `seconds` against the spring, until
    `seen`, which gets each, says False. AnalysisError if force ends meanwhile.
    """
    pieces: list[Records] = []
    with rendering(bench, SPRING, RAMP_S):
        words = f"move the handle to and fro by some mm, some times a second, for {seconds:g} s"
        ask(Request("shake", f"from now on: {words}", seconds))
        for _ in range(round(seconds / PIECE_S)):
            pieces.append(collect(bench, PIECE_S).records)
            require_force(bench.status())
            if not seen(pieces[-1]):
                break
    return pieces


def raw_of(pieces: Sequence[Records]) -> dict[str, npt.NDArray[Any]]:
    """The raw record."""
    return {name: np.concatenate([one[name] for one in pieces]) for name in RAW}
