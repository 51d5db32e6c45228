"""Force per count by a known spring, for a handle from which no masses can hang.

The spring of k [N/m] holds the handle, and a far wall pulls at it to either side, with LEVELS steps
of force going up and the same going down again. At rest

    s F + o = k (x - x0) +- f

with the commanded F, newtons per commanded newton s, the motor's offset o, the place x0 where the
spring is slack, and the friction f. Friction has opposite signs on the way up and on the way down,
so it cancels in the mean of the two. The line x(F) has the slope s / k. o cannot be separated from
x0; it is measured without a spring (`measure_offset`). Forces of both signs are on the line, so its
residuals show a nonlinear motor, a nonlinear spring, or a lever that slips.

Limitations: a spring that buckles or is stretched to its end (residuals), and a wrong scale of
position (`rig encoder` comes first).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot
from typing import Any

import numpy as np

from hapticd.client.client import Client
from hapticd.core.arrays import Floats
from hapticd.rig.estimate import line, mean_half
from hapticd.rig.experiment import begin_step, collect, pull, release, under_force
from hapticd.rig.hand import Ask, Request
from hapticd.rig.result import Finding, StepResult, Value
from hapticd.rig.steps.motor import (
    DRAWN_SHARE,
    REPEATS,
    believable,
    friction_of,
    full_scale,
    full_scale_changes,
    limit_n,
    offset_of,
    rests_n,
    straight,
    zero_change,
)

__all__ = ["Spring", "measure", "measure_offset"]

LEVELS = 3
OVERSHOOT = 1.3  # beyond the last level, so that the way down begins above it
MOST_M = 4e-3  # of stretch
SHARE = 0.4  # of the force limit, at most
RAMP_S = 0.5
SETTLE_S = 0.8
READ_S = 0.5
OFFSET_REPEATS = 3
HELD_N_PER_M = 200.0  # rendered while the offset is measured
Rest = tuple[float, float]  # means at rest: commanded force [N] and position [m]


@dataclass(frozen=True)
class Spring:
    """A spring between handle and frame."""

    n_per_m: float
    tolerance: float = 0.01  # relative, half of the 95 % interval


def measure(bench: Client, ask: Ask, spring: Spring) -> StepResult:
    """Request the spring, pull at it and fit the line. CommandError unless disabled; AnalysisError
    if the signs are not verified.
    """
    servo = begin_step(bench, "the gain is measured")
    most_n = min(SHARE * limit_n(servo), MOST_M * spring.n_per_m) / OVERSHOOT
    text = f"put the spring of {spring.n_per_m:g} N/m between handle and frame, and let go"
    ask(Request("spring", text, spring.n_per_m))
    with under_force(bench):
        start_m = float(collect(bench, READ_S).records["position_m"].mean())
        loops = [_loop(bench, side * most_n, start_m) for side in (1.0, -1.0)]
    ask(Request("let go", "take the spring off and let go"))
    return analyse(np.array(loops).reshape(-1, 2, 2), spring, servo["device"])


def _loop(bench: Client, most_n: float, start_m: float) -> list[list[Rest]]:
    """Return rests at each level, once on the way up and once on the way down: (LEVELS, 2)."""
    levels = [most_n * step / LEVELS for step in range(1, LEVELS + 1)]
    up = [_rest(bench, level, start_m) for level in levels]
    _rest(bench, most_n * OVERSHOOT, start_m)
    down = [_rest(bench, level, start_m) for level in reversed(levels)]
    release(bench, RAMP_S, SETTLE_S)
    return [[first, second] for first, second in zip(up, reversed(down), strict=True)]


def _rest(bench: Client, force_n: float, start_m: float) -> Rest:
    pull(bench, force_n, start_m, RAMP_S, SETTLE_S)
    found = collect(bench, READ_S).records
    return float(found["force_n"].mean()), float(found["position_m"].mean())


def analyse(rests: Floats, spring: Spring, device: Mapping[str, Any]) -> StepResult:
    """Fit `rests` (n, 2, 2), of levels, way up and down, [N] and [m], with scale and limits of the
    hello's `device`.
    """
    forces, places = rests.mean(axis=1).T
    found = line(forces, places)
    slope = float(found.values[0])
    scale = spring.n_per_m * slope
    ways = np.diff(rests, axis=1)[:, 0]
    friction_m = float(np.abs(ways[:, 1] - slope * ways[:, 0]).mean()) / 2.0
    slope_half = hypot(float(found.halves[0]), REPEATS * friction_m / float(np.ptp(forces)))
    gain = full_scale(scale, device, hypot(slope_half / abs(slope), spring.tolerance))
    friction = spring.n_per_m * friction_m
    seen = Value.around("friction seen", friction, "N", friction)
    remedy = "does the spring buckle or end, the lever slip, or the handle stick? Repeat the step"
    return StepResult(
        "motor",
        (gain, seen),
        (straight(found, places, "stretch", remedy), believable(scale)),
        tuple(full_scale_changes(gain, scale, device)),
        {"rests": rests},
    )


def measure_offset(bench: Client, ask: Ask, repeats: int = OFFSET_REPEATS) -> StepResult:
    """Measure the count of zero force: a rendered spring holds the free handle, which comes to rest
    from either side. CommandError unless disabled; AnalysisError if the signs are not verified.
    """
    servo = begin_step(bench, "the offset is measured")
    ask(Request("let go", "release the handle, with no mass attached"))
    drawn_n = DRAWN_SHARE * limit_n(servo)
    with under_force(bench):
        bench.set(K=HELD_N_PER_M, ramp_s=1.0)
        readings = np.array([rests_n(bench, drawn_n) for _ in range(repeats)])
    means = readings.mean(axis=1)
    half_n = hypot(mean_half(means), REPEATS * friction_of(readings))
    offset = offset_of(float(means.mean()), half_n, servo["device"])
    finding = Finding(f"{offset.value:.3g} counts make no force", "ok")
    return StepResult(
        "motor", (offset,), [finding], [zero_change(offset)], {"readings_n": readings}
    )
