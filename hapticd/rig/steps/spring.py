"""Force per count by a known spring, for a handle from which no masses can hang.

The spring of k [N/m] holds the handle, and a far wall pulls at it to either side, with LEVELS steps
of force going up and the same going down again. At rest

    s F + o = k (x - x0) +- f

with the commanded F, what a commanded newton really is (s), the motor's offset o, the place x0
where the spring is slack, and the friction f, which has one sign on the way up and the other on the
way down: it cancels in the mean of the two. The line x(F) has the slope s / k. o cannot be told
from x0; it is measured without a spring (`measure_offset`). Forces of both signs are on the line,
so its residuals show a motor that is not linear, a spring that is not, or a lever that slips.

What would break it: a spring that buckles or is stretched to its end (residuals), and a scale of
position that is wrong (`rig encoder` comes first).
"""

from dataclasses import dataclass
from math import hypot
from typing import Any, NamedTuple

import numpy as np

from hapticd.client.client import Client
from hapticd.core.arrays import Floats
from hapticd.core.units import percent
from hapticd.rig.hand import Ask, Request
from hapticd.rig.push import ready, wall_of
from hapticd.rig.records import collect
from hapticd.rig.result import UPPER_END, Change, Finding, StepResult, Value, rounded, settled
from hapticd.rig.steps.link import require_disabled, require_force, require_verified
from hapticd.rig.steps.motor import (
    MOST_RESIDUAL,
    REPEATS,
    UNBOUNDED,
    Most,
    believable,
    fitted,
    full_scale_changes,
    limit_n,
    most_of,
    settled_n,
)
from hapticd.signal.verdict import student_quantile
from hapticd.usb.codec import I16_HIGHEST

__all__ = ["Spring", "measure", "measure_offset"]

LEVELS = 3
OVERSHOOT = 1.3  # beyond the last level, so that the way down begins beyond it
MOST_M = 4e-3  # of stretch
SHARE = 0.4  # of the force limit, at most
RAMP_S = 0.5
SETTLE_S = 0.8
READ_S = 0.5
OFFSET_REPEATS = 3
HELD_N_PER_M = 200.0  # rendered while the offset is measured
DRAWN_SHARE = 0.1  # of the force limit


@dataclass(frozen=True)
class Spring:
    """Between handle and frame."""

    n_per_m: float
    tolerance: float = 0.01  # relative, half of the 95 % interval


class Rest(NamedTuple):
    """Means of the handle at rest."""

    force_n: float  # commanded
    position_m: float


def measure(bench: Client, ask: Ask, spring: Spring) -> StepResult:
    """Ask for the spring, pull at it and fit the line. CommandError unless disabled; AnalysisError
    where signs are not verified.
    """
    require_disabled(bench)
    servo = bench.hello().servo
    require_verified(servo, "the gain is measured")
    most_n = min(SHARE * limit_n(servo), MOST_M * spring.n_per_m) / OVERSHOOT
    ask(
        Request(
            "spring",
            f"put the spring of {spring.n_per_m:g} N/m between handle and frame, and let go",
            spring.n_per_m,
        )
    )
    with ready(bench):
        start_m = float(collect(bench, READ_S).records["position_m"].mean())
        loops = [_loop(bench, side * most_n, start_m) for side in (1.0, -1.0)]
        status = bench.status()
    require_force(status)
    ask(Request("let go", "take the spring off and let go"))
    rests = np.array(loops).reshape(-1, 2, 2)
    device = servo["device"]
    return concluded(rests, spring, device["force"], most_of(device))


def _loop(bench: Client, most_n: float, start_m: float) -> list[list[Rest]]:
    """Rests at each level, once on the way up and once on the way down: (LEVELS, 2)."""
    levels = [most_n * step / LEVELS for step in range(1, LEVELS + 1)]
    up = [_rest(bench, level, start_m) for level in levels]
    _rest(bench, most_n * OVERSHOOT, start_m)
    down = [_rest(bench, level, start_m) for level in reversed(levels)]
    bench.set(wall={"stiffness_n_per_m": 0.0}, ramp_s=RAMP_S)
    collect(bench, RAMP_S + SETTLE_S)
    return [[first, second] for first, second in zip(up, reversed(down), strict=True)]


def _rest(bench: Client, force_n: float, start_m: float) -> Rest:
    bench.set(wall=wall_of(force_n, start_m), ramp_s=RAMP_S)
    collect(bench, RAMP_S + SETTLE_S)
    found = collect(bench, READ_S).records
    return Rest(float(found["force_n"].mean()), float(found["position_m"].mean()))


def concluded(
    rests: Floats, spring: Spring, force: dict[str, Any], most: Most = UNBOUNDED
) -> StepResult:
    """What `rests` (n, 2, 2), of levels, way up and down, [N] and [m], say with the file's scale
    `force` and what it allows at `most`.
    """
    forces, places = rests.mean(axis=1).T
    line = fitted(forces, places)
    scale = spring.n_per_m * line.slope
    ways = np.diff(rests, axis=1)[:, 0]
    friction_m = float(np.abs(ways[:, 1] - line.slope * ways[:, 0]).mean()) / 2.0
    slope_half = hypot(line.slope_half, REPEATS * friction_m / float(np.ptp(forces)))
    relative = hypot(slope_half / abs(line.slope), spring.tolerance)
    full_n = scale * I16_HIGHEST * float(force["per_count"])
    half = relative * abs(full_n)
    gain = Value("force.full_scale_n", full_n, "N", full_n - half, full_n + half)
    friction = spring.n_per_m * friction_m
    seen = Value("friction seen", friction, "N", 0.0, 2.0 * friction)
    share = line.worst / float(np.ptp(places))
    findings = [_linear(share), believable(scale)]
    changes = full_scale_changes(gain, full_n / scale, most)
    arrays = {"rests": rests}
    return StepResult("motor", (gain, seen), findings, changes if settled(findings) else (), arrays)


def _linear(share: float) -> Finding:
    what = f"the worst reading lies {percent(share)} of the stretch beside the line"
    if share <= MOST_RESIDUAL:
        return Finding(what, "ok")
    remedy = "does the spring buckle or end, the lever slip, or the handle stick? Repeat the step"
    return Finding(what, "refused", remedy)


def measure_offset(bench: Client, ask: Ask, repeats: int = OFFSET_REPEATS) -> StepResult:
    """Which count makes no force: a rendered spring holds the free handle, which comes to rest from
    either side. CommandError unless disabled; AnalysisError where signs are not verified.
    """
    require_disabled(bench)
    servo = bench.hello().servo
    require_verified(servo, "the offset is measured")
    ask(Request("let go", "let go of the handle, with nothing hanging from it"))
    drawn_n = DRAWN_SHARE * limit_n(servo)
    with ready(bench):
        bench.set(K=HELD_N_PER_M, ramp_s=1.0)
        readings = [
            [settled_n(bench, side * drawn_n) for side in (1.0, -1.0)] for _ in range(repeats)
        ]
        status = bench.status()
    require_force(status)
    return offset_concluded(np.array(readings), servo["device"]["force"])


def offset_concluded(readings_n: Floats, force: dict[str, Any]) -> StepResult:
    """What commanded forces (n, 2) at rest, from above and from below, say."""
    per_n = int(force["sign"]) / float(force["per_count"])
    means = per_n * readings_n.mean(axis=1)
    friction = abs(per_n) * float(np.abs(np.diff(readings_n, axis=1)).mean()) / 2.0
    spread = student_quantile(UPPER_END, len(means) - 1) * float(means.std(ddof=1))
    half = hypot(spread / np.sqrt(len(means)), REPEATS * friction)
    middle = float(force["offset_count"]) + float(means.mean())
    value = Value("force.offset_count", middle, "counts", middle - half, middle + half)
    changes = [Change("force", "offset_count", rounded(value.value, value.low, value.high))]
    finding = Finding(f"{middle:.3g} counts make no force", "ok")
    return StepResult("motor", (value,), [finding], changes, {"readings_n": readings_n})
