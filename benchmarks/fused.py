"""A 90 s trial from simulation to spectra, without a record: the scene of `engine` with 4 states,
float32, one core.

CPU time of one thread for a group of 64 trials compared with the C of the same scene, which stores
every sample in the cache, and FFTW's spectra of as many records (force transformed before). They
run in turns; the minimum of the rounds of each counts.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from typing import Any

from benchmarks import targets
from benchmarks.engine_c import C_LANES, CReference, check_same
from benchmarks.engine_scene import NOISE, Lanes, environments, least_cpu_s, model
from benchmarks.figures import Figure, compared
from benchmarks.spa_c import SpectraYard
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.zwidth.engine.batch import simulate

TARGETS = targets.of("fused")
TRIALS = 64
SECONDS = 90.0
ROUNDS = 12
TICKS = 512
MS = 1e3


class Here(Executor):
    """Runs each task at once, on this thread."""

    def submit(self, task: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        """Run the task and return its result."""
        done: Future[Any] = Future()
        done.set_result(task(*args, **kwargs))
        return done


def measure() -> Iterator[Figure]:
    """Measure all interleaved; kernels compiled and the torque made before."""
    device = model()
    points = environments(TRIALS)
    samples = round(SECONDS * PROBE_RATE_HZ)

    def run() -> None:
        simulate(
            device,
            points,
            SECONDS,
            1,
            excitation=NOISE,
            dtype="f32",
            keep="spectra",
            executor=Here(),
            chunk=TRIALS,
        )

    spectra = SpectraYard(samples, float(PROBE_RATE_HZ))
    runs: dict[str, Any] = {"ours": run, "fftw": spectra.one} | _in_c(device)
    taken_s = least_cpu_s(runs, ROUNDS)
    step_s = min(
        taken_s[name] / run.steps for name, run in runs.items() if isinstance(run, CReference)
    )
    reference_ms = MS * (step_s * samples + taken_s["fftw"])
    note = f"C {MS * step_s * samples:.3g} ms, FFTW {MS * taken_s['fftw']:.3g} ms"
    yield compared(
        "fused_c", TARGETS["fused_c"], MS * taken_s["ours"] / TRIALS, "ms", reference_ms, note
    )


def _in_c(device: Any) -> dict[str, CReference]:
    """Return the C at each lane count, storing every sample."""
    check_same(
        Lanes(device, "f32", TICKS),
        CReference(Lanes(device, "f32", TICKS), "f32", C_LANES["f32"][0]),
        "f32",
    )
    made = {
        f"C {lanes}": CReference(Lanes(device, "f32", TICKS), "f32", lanes)
        for lanes in C_LANES["f32"]
    }
    for one in made.values():
        one.kept = 1
    return made
