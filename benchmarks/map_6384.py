"""The paper's grid by trials: 6,384 environments, undamped and damped, 90 s each on the calibrated device. Wall clock.

A laboratory needs 13 days for it. All trials are made, near the predicted boundary with 4 sub-steps, elsewhere with one.
"""

import time
from collections.abc import Iterator

from benchmarks.figures import Figure, compared
from hapticd.measure.campaign import MapParams, plan_map, run_map
from hapticd.measure.outcomes import Conditions
from hapticd.measure.reproduce_grid import AXES
from hapticd.measure.scenes import noise
from hapticd.measure.store import TrialStore
from hapticd.settings.scene import load_scene

TARGETS = {"map_6384_s": "<= 30"}
SCENE, LEVELS_NS_PER_M = "fig7", (0.0, 1.74)


def measure() -> Iterator[Figure]:
    """Seconds for both levels, prediction included, kernels compiled before."""
    scene = load_scene(SCENE)
    conditions = Conditions(scene, 90.0, noise(scene))
    few = tuple(axis[:2] for axis in AXES)
    run_map(plan_map(MapParams(conditions, (few[0], few[1], few[2]), LEVELS_NS_PER_M, everywhere=True)), TrialStore(None))
    begin = time.perf_counter()
    plan = plan_map(MapParams(conditions, AXES, LEVELS_NS_PER_M, everywhere=True))
    found = run_map(plan, TrialStore(None))
    taken_s = time.perf_counter() - begin
    near = sum(int(level.near.sum()) for level in plan.levels)
    passive = ", ".join(f"{int(level.found.passive.sum())}" for level in found.levels)
    assert found.made == 2 * 6384
    note = f"{found.made} trials, {near} of them with 4 sub-steps; {passive} passive"
    yield compared("map_6384_s", TARGETS["map_6384_s"], taken_s, "s", None, note)
