"""Trials per second of a map in a pool of processes and on a Dask cluster, relative to threads of
this process.

The same map each time, trials of 90 s, kernels warm, pools running: one worker of one thread a
core. They take turns, and the minimum time of each counts, so that other programs affect all alike.
The map is long compared with a task, since at its end one core waits for the last one.
"""

import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import ExitStack

import numpy as np

from benchmarks import targets
from benchmarks.figures import Figure, compared
from benchmarks.worker import BenchError
from hapticd.settings.scene import load_scene
from hapticd.zwidth.engine.batch import workers
from hapticd.zwidth.executors import executor
from hapticd.zwidth.map import MapParams, MapPlan, plan_map, run_map
from hapticd.zwidth.outcomes import TOGETHER, Conditions
from hapticd.zwidth.store import TrialStore

TARGETS = targets.of("executors")
SCENE = "fig7"
ROUNDS = 10
ENOUGH_S = 40.0  # after which no round begins, on a busy machine
NEAR = 0.6  # of the boundary: the whole map, in one batch
# tasks before, and in a round
WARM = 4
TASKS = 20


def measure() -> Iterator[Figure]:
    """Yield both ratios; `value` is the pool's trials a second, `reference` that of the threads."""
    with ExitStack() as stack:
        begin = time.perf_counter()
        pools: dict[str, Executor | None] = {"thread": None}
        pools["executor_process"] = stack.enter_context(executor("process"))
        for pool in pools.values():  # before Dask changes the environment of new processes
            _taken_s(_map(WARM), pool)
        pools["executor_dask"] = stack.enter_context(executor(_cluster(stack)))
        _taken_s(_map(WARM), pools["executor_dask"])
        started_s = time.perf_counter() - begin
        plan = _map(TASKS)
        taken: dict[str, list[float]] = {name: [] for name in pools}
        while not taken["thread"] or (
            len(taken["thread"]) < ROUNDS and time.perf_counter() - begin < ENOUGH_S
        ):
            for name, pool in pools.items():
                taken[name].append(_taken_s(plan, pool))
    rate = {name: plan.trials / min(times) for name, times in taken.items()}
    rounds = len(taken["thread"])
    note = (
        f"{plan.trials} trials of 90 s, {workers()} cores, {rounds} rounds;"
        f" pools warm in {started_s:.1f} s"
    )
    for name, target in TARGETS.items():
        yield compared(name, target, rate[name], "1/s", rate["thread"], note)


def _cluster(stack: ExitStack) -> str:
    """Start a cluster of processes, closed with `stack`; return its name as an executor."""
    try:
        from distributed import LocalCluster

        cluster = stack.enter_context(
            LocalCluster(n_workers=workers(), threads_per_worker=1, dashboard_address=":0")
        )
    except ImportError as error:
        raise BenchError(f"Dask is missing ({error}): `make bench` installs it") from error
    except RuntimeError as error:
        raise BenchError(f"no Dask cluster here: {error}") from error
    return str(cluster.scheduler_address).replace("tcp://", "dask://")


def _map(tasks: int) -> MapPlan:
    """Return a map of about `tasks` tasks, on both sides of the boundary."""
    scene = load_scene(SCENE)
    axes = (
        np.linspace(200.0, 1200.0, tasks),
        np.linspace(2.0, 9.0, 8),
        np.linspace(-0.02, 0.02, TOGETHER // 8),
    )
    return plan_map(MapParams(Conditions(scene, excitation=scene.noise), axes, (1.74,), NEAR))


def _taken_s(plan: MapPlan, pool: Executor | None) -> float:
    """Return the wall seconds of the whole map, without earlier results."""
    begin = time.perf_counter()
    made = run_map(plan, TrialStore(None), executor=pool).made
    assert made == plan.trials
    return time.perf_counter() - begin
