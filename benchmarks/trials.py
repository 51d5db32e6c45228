"""1,000 trials of 90 s compared with C of the same scene, and the cost of a new scene before its
first one.

Wall time of `simulate` on all cores, warm, against the C of the same states, friction and sub-steps
on all cores. They run in turns and for as many steps; the minimum of the rounds of each counts. The
first kernel is timed in fresh processes with an empty cache folder and again with the cached
result: information, since the compiler's time is external. Last the peak memory of a process that
keeps sums only.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator

from benchmarks import targets
from benchmarks.engine_c import Yard
from benchmarks.engine_scene import Lanes, environments, model
from benchmarks.figures import Figure, compared
from benchmarks.worker import ROOT, BenchError, environment
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.model.compose import compose
from hapticd.model.model import Model
from hapticd.model.scene import Scene
from hapticd.settings.scene import load_scene
from hapticd.zwidth.engine.batch import simulate, workers

TARGETS = targets.of("trials")
SCENE = "fig7"
TICKS = 1024  # of a call of the C
TRIALS = 1000
SECONDS = 90.0
ROUNDS = 9
PROCESSES = 3
PROCESS_S = 120.0


def measure() -> Iterator[Figure]:
    """Yield timings first, then fresh processes."""
    weir = load_scene(SCENE)
    level_ns_per_m = weir.active_damping[0].level_ns_per_m
    yield _batch("trials_1000_c", model(), model(), 1, 0.0)
    for substeps in (1, 4):
        yield _batch(f"trials_weir_{substeps}_c", weir, compose(weir), substeps, level_ns_per_m)
    yield from _first_kernel()
    yield compared(
        "engine_rss_mb",
        TARGETS["engine_rss_mb"],
        _ask("memory", os.environ.get("XDG_CACHE_HOME")),
        "MB",
    )


def _batch(
    name: str, scene: Scene | Model, device: Model, substeps: int, level_ns_per_m: float
) -> Figure:
    params = environments(TRIALS)
    simulate(scene, params, 1.0, substeps=substeps)
    yard = Yard(
        Lanes(device, "f64", TICKS, substeps=substeps, level_ns_per_m=level_ns_per_m), "f64"
    )
    taken = []
    samples = TRIALS * SECONDS * PROBE_RATE_HZ
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        simulate(scene, params, SECONDS, substeps=substeps)
        taken.append(time.perf_counter() - begin)
        yard.time(samples)
    note = f"f64, {TRIALS} trials of {SECONDS:g} s on {workers()} cores"
    return compared(name, TARGETS[name], min(taken), "s", samples * min(yard.found), note)


def _first_kernel() -> Iterator[Figure]:
    cold = []
    cached = []
    for _ in range(PROCESSES):
        with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder:
            cold.append(_ask("first", folder))
            cached.append(_ask("first", folder))
    yield compared(
        "kernel_cold_s",
        TARGETS["kernel_cold_s"],
        min(cold),
        "s",
        note="fresh process after its imports, empty cache",
    )
    yield compared(
        "kernel_cached_s",
        TARGETS["kernel_cached_s"],
        min(cached),
        "s",
        note="the same with the kernel on disk",
    )


def _ask(question: str, cache: str | None) -> float:
    """Return the answer of a fresh `trials_worker`. BenchError if it fails."""
    variables = {**environment(), **({"XDG_CACHE_HOME": cache} if cache else {})}
    command = [sys.executable, "-m", "benchmarks.trials_worker", question]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
        env=variables,
        cwd=ROOT,
        timeout=PROCESS_S,
    )
    if done.returncode:
        raise BenchError(f"trials_worker {question} failed: {done.stderr.strip().splitlines()[-1]}")
    return float(json.loads(done.stdout))
