"""A 90 s trial from simulation to spectra, without a record: the scene of `engine` with 4 states, float32, one core.

CPU time of one thread for a group of 64 trials, least of all rounds; beside it the same with records and `spa` afterwards.
"""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from typing import Any

from benchmarks.engine_scene import NOISE, environments, model
from benchmarks.figures import Figure, compared
from hapticd.analysis.spa import spa
from hapticd.sim.engine import simulate

TARGETS = {"fused_ms": "<= 1"}
TRIALS, SECONDS, ROUNDS = 64, 90.0, 8
MS = 1e3


class Here(Executor):
    """Does each task at once, on this thread."""

    def submit(self, task: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        """As any executor."""
        done: Future[Any] = Future()
        done.set_result(task(*args, **kwargs))
        return done


def measure() -> Iterator[Figure]:
    """Both ways, interleaved; kernels compiled and the torque made before."""
    device, points = model(), environments(TRIALS)

    def run(keep: str) -> Any:
        return simulate(device, points, SECONDS, 1, excitation=NOISE, dtype="f32", keep=keep, executor=Here(), chunk=TRIALS)

    def apart() -> None:
        found = run("records")
        for trial in range(TRIALS):
            spa(*found.record(trial))

    least = {"together": float("inf"), "apart": float("inf")}
    for round_ in range(ROUNDS + 1):
        for name, work in (("together", lambda: run("spectra")), ("apart", apart)):
            begin = time.thread_time()
            work()
            if round_:
                least[name] = min(least[name], time.thread_time() - begin)
    together, separate = (MS * least[name] / TRIALS for name in ("together", "apart"))
    yield compared("fused_ms", TARGETS["fused_ms"], together, "ms", separate, "reference: records, then spa of each")
