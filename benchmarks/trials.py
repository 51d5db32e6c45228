"""1,000 trials of 90 s, and what a new scene costs before its first one.

Wall time of `simulate` on all cores, warm, least of some rounds; the first kernel in fresh processes with an empty cache folder
and again with what the first left there; peak memory of a process that keeps sums only.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator

from benchmarks.engine_scene import environments, model
from benchmarks.figures import Figure, compared
from benchmarks.worker import ROOT, BenchError, environment
from hapticd.settings.scene import load_scene
from hapticd.sim.engine import simulate
from hapticd.sim.engine.cores import workers

TARGETS = {
    "trials_1000_s": "<= 0.25",
    "trials_weir_1_s": "<= 0.4",
    "trials_weir_4_s": "<= 1.0",
    "kernel_cold_s": "<= 3",
    "kernel_cached_s": "<= 0.5",
    "engine_rss_mb": "<= 300",
}
TRIALS, SECONDS, ROUNDS, PROCESSES = 1000, 90.0, 7, 3
PROCESS_S = 120.0


def measure() -> Iterator[Figure]:
    """Timings first, then fresh processes."""
    weir = load_scene("fig7")
    yield _batch("trials_1000_s", model(), substeps=1)
    yield _batch("trials_weir_1_s", weir, substeps=1)
    yield _batch("trials_weir_4_s", weir, substeps=4)
    yield from _first_kernel()
    yield compared("engine_rss_mb", TARGETS["engine_rss_mb"], _ask("memory", os.environ.get("XDG_CACHE_HOME")), "MB")


def _batch(name: str, scene: object, **options: object) -> Figure:
    params = environments(TRIALS)
    simulate(scene, params, 1.0, **options)  # type: ignore[arg-type]
    wall_s, cpu_s = zip(*(_timed(scene, params, options) for _ in range(ROUNDS)), strict=True)
    note = f"f64, {TRIALS} trials of {SECONDS:g} s on {workers()} cores; {min(cpu_s):.3g} s of CPU"
    return compared(name, TARGETS[name], min(wall_s), "s", note=note)


def _timed(scene: object, params: object, options: dict[str, object]) -> tuple[float, float]:
    """(wall, CPU) seconds."""
    wall, cpu = time.perf_counter(), time.process_time()
    simulate(scene, params, SECONDS, **options)  # type: ignore[arg-type]
    return time.perf_counter() - wall, time.process_time() - cpu


def _first_kernel() -> Iterator[Figure]:
    cold, cached = [], []
    for _ in range(PROCESSES):
        with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder:
            cold.append(_ask("first", folder))
            cached.append(_ask("first", folder))
    yield compared("kernel_cold_s", TARGETS["kernel_cold_s"], min(cold), "s", note="fresh process after its imports, empty cache")
    yield compared("kernel_cached_s", TARGETS["kernel_cached_s"], min(cached), "s", note="the same with the kernel on disk")


def _ask(question: str, cache: str | None) -> float:
    """Answer of a fresh `trials_worker`. BenchError when it fails."""
    variables = {**environment(), **({"XDG_CACHE_HOME": cache} if cache else {})}
    command = [sys.executable, "-m", "benchmarks.trials_worker", question]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=variables, cwd=ROOT, timeout=PROCESS_S)
    if done.returncode:
        raise BenchError(f"trials_worker {question} failed: {done.stderr.strip().splitlines()[-1]}")
    return float(json.loads(done.stdout))
