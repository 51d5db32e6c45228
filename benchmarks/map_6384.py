"""The paper's grid by trials: 6,384 environments, undamped and damped, 90 s each on the calibrated
device. Wall clock.

A laboratory needs 13 days for it. All trials are made, near the predicted boundary with 4
sub-steps, elsewhere with one. They run as in `hapticd zwidth map`, in a process for each core; the
start of the processes counts, their end does not. The yardstick is the cost of the same trials in C
with the same sub-steps, every sample stored, and their spectra by FFTW, all cores at once. It is
timed before, between and after the two levels, and its median counts.
"""

import time
from collections.abc import Iterator
from statistics import median

from benchmarks import targets
from benchmarks.engine_c import Yard
from benchmarks.engine_scene import Lanes
from benchmarks.figures import Figure, compared
from benchmarks.spa_c import SpectraYard
from examples.weir2008.run import AXES
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.model.compose import compose
from hapticd.settings.scene import load_scene
from hapticd.zwidth.engine.batch import workers
from hapticd.zwidth.executors import executor
from hapticd.zwidth.map import MapParams, plan_map, run_map
from hapticd.zwidth.outcomes import Conditions
from hapticd.zwidth.store import TrialStore

TARGETS = targets.of("map_6384")
SCENE = "fig7"
LEVELS_NS_PER_M = (0.0, 1.74)
SECONDS = 90.0
# of the C; of a turn of the yardstick; trials in a round
TICKS = 512
ROUNDS = 5
TOGETHER = 64
POINTS = 6384  # of the grid


class Yardstick:
    """C of both kinds of trial, and their spectra."""

    def __init__(self, level_ns_per_m: float) -> None:
        device = compose(load_scene(SCENE))
        self.samples = round(SECONDS * PROBE_RATE_HZ)
        self.plain, self.fine = (
            Yard(
                Lanes(device, "f32", TICKS, substeps=count, level_ns_per_m=level_ns_per_m),
                "f32",
                keep=True,
            )
            for count in (1, 4)
        )
        self.spectra = SpectraYard(self.samples, float(PROBE_RATE_HZ))

    def turn(self) -> None:
        """Run some rounds of each."""
        for _ in range(ROUNDS):
            for one in (self.plain, self.fine):
                one.time(TOGETHER * self.samples)
            self.spectra.time(TOGETHER // workers())

    def wall_s(self, trials: int, near: int) -> float:
        """Return the wall time of `trials`, `near` of them with 4 sub-steps."""
        plain_s, fine_s = (self.samples * median(one.found) for one in (self.plain, self.fine))
        return (
            (trials - near) * plain_s
            + near * fine_s
            + trials * median(self.spectra.found) / workers()
        )


def measure() -> Iterator[Figure]:
    """Measure both levels, including prediction, with kernels compiled before."""
    scene = load_scene(SCENE)
    conditions = Conditions(scene, SECONDS, scene.noise)
    few = tuple(axis[:2] for axis in AXES)
    run_map(
        plan_map(MapParams(conditions, (few[0], few[1], few[2]), LEVELS_NS_PER_M, everywhere=True)),
        TrialStore(None),
    )
    yardstick = Yardstick(LEVELS_NS_PER_M[-1])
    taken_s = 0.0
    near = 0
    trials = 0
    yardstick.turn()
    begin = time.perf_counter()
    with executor("auto", trials=2 * POINTS) as pool:
        for level in LEVELS_NS_PER_M:
            plan = plan_map(MapParams(conditions, AXES, (level,), everywhere=True))
            found = run_map(plan, TrialStore(None), executor=pool)
            taken_s += time.perf_counter() - begin
            near += int(plan.levels[0].near.sum())
            trials += found.made
            yardstick.turn()
            begin = time.perf_counter()
    assert trials == 2 * POINTS
    note = f"{trials} trials, {near} of them with 4 sub-steps"
    yield compared(
        "map_6384_c", TARGETS["map_6384_c"], taken_s, "s", yardstick.wall_s(trials, near), note
    )
