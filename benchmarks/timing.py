"""Benefit of a shorter delay from sample to force: the largest stiffness of a rigid display by
simulated trials of 90 s, with transfers in flight relative to sequential ones.

No time is measured; the figure is the same on every machine. `docs/timing.py` has more rows.
"""

from collections.abc import Iterator
from dataclasses import replace

from benchmarks import targets
from benchmarks.figures import Figure, compared
from hapticd.model.effects import Delay, Viscous
from hapticd.model.scene import Scene
from hapticd.settings.scene import load_scene
from hapticd.zwidth.limits import ORIGIN, AxisLimit, LimitsParams, plan_limits, run_limits
from hapticd.zwidth.outcomes import Conditions, Point
from hapticd.zwidth.store import TrialStore

TARGETS = targets.of("timing")
SEQUENTIAL_PERIODS = 0.6875  # a pair of transfers of 0.4 ms, one after the other (ADR-0008)
IN_FLIGHT_PERIODS = 0.25
PHYSICAL_NS_PER_M = 0.36


def rigid(physical_ns_per_m: float, delay_periods: float) -> Scene:
    """Return a rigid mass of 8 g with only that viscous damping and delay."""
    scene = load_scene("theory")
    viscous = Viscous(rotor_ns_per_m=physical_ns_per_m, source="inferred")
    effects = [viscous if isinstance(one, Viscous) else one for one in scene.effects]
    delay = Delay(periods=delay_periods, source="inferred")
    return replace(scene, effects=(*effects, delay))


def tried_limit(scene: Scene, axis: int = 0, base: Point = ORIGIN, seeds: int = 1) -> AxisLimit:
    """Return the limit of K (axis 0) or B (1) without active damping, by trials of 90 s."""
    params = LimitsParams(Conditions(scene), levels=(0.0,), axes=(axis,), base=base, seeds=seeds)
    return run_limits(plan_limits(params), TrialStore(None)).limits[0]


def measure() -> Iterator[Figure]:
    """Yield the gain of the rigid row."""
    sequential, in_flight = (
        tried_limit(rigid(PHYSICAL_NS_PER_M, delay)).value
        for delay in (SEQUENTIAL_PERIODS, IN_FLIGHT_PERIODS)
    )
    yield compared(
        "timing_stiffness_ratio",
        TARGETS["timing_stiffness_ratio"],
        in_flight,
        "N/m",
        sequential,
        "model: trials of the batch engine, no bus",
    )
