"""Wake-up latency of the servo's wait against cyclictest: same priority, same core, same period,
block by block.
"""

import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager

from benchmarks import cyclictest, targets
from benchmarks.blocks import median_quantile
from benchmarks.figures import Figure, compared, refused
from benchmarks.worker import Worker
from hapticd.core.params import RealtimeParams
from hapticd.core.units import NS_PER_US

TARGETS = targets.of("wake")
PERIOD_US = 1000
ROUNDS = 15
SAMPLES = 900
STRESS_ROUNDS = 6
STRESS_SAMPLES = 2000
STRESS_SETTLE_S = 2.0
LOAD = (
    "--cpu",
    "2",
    "--vm",
    "1",
    "--vm-bytes",
    "256M",
    "--hdd",
    "1",
    "--hdd-bytes",
    "128M",
    "--io",
    "1",
)
SPIN_US = RealtimeParams().spin_us

Blocks = dict[str, list[list[int]]]


def measure() -> Iterator[Figure]:
    """Yield the five figures; ratios of medians over blocks."""
    with Worker("wake_worker") as worker:
        quiet = _blocks(worker, ROUNDS, SAMPLES, {"spin": SPIN_US, "sleep": 0.0})
        for name, kind, fraction in (
            ("wake_p50", "spin", 0.5),
            ("wake_p99", "spin", 0.99),
            ("wake_sleep_p50", "sleep", 0.5),
            ("wake_sleep_p99", "sleep", 0.99),
        ):
            yield _figure(name, quiet, kind, fraction, worker.note)
        if shutil.which("stress-ng") is None:
            yield refused(
                "wake_stress_p99",
                TARGETS["wake_stress_p99"],
                "stress-ng is missing: `make deps` installs it",
            )
            return
        with _stress():
            loaded = _blocks(worker, STRESS_ROUNDS, STRESS_SAMPLES, {"spin": SPIN_US})
        yield _figure("wake_stress_p99", loaded, "spin", 0.99, worker.note)


def _blocks(worker: Worker, rounds: int, samples: int, kinds: dict[str, float]) -> Blocks:
    found: Blocks = {"cyclictest": [], **{kind: [] for kind in kinds}}
    for _ in range(rounds):
        found["cyclictest"].append(cyclictest.latencies_ns(samples, PERIOD_US))
        for kind, spin_us in kinds.items():
            found[kind].append(worker.ask(samples=samples, period_us=PERIOD_US, spin_us=spin_us))
    return found


def _figure(name: str, blocks: Blocks, kind: str, fraction: float, note: str) -> Figure:
    ours = median_quantile(blocks[kind], fraction) / NS_PER_US
    theirs = median_quantile(blocks["cyclictest"], fraction) / NS_PER_US
    return compared(name, TARGETS[name], ours, "us", theirs, note)


@contextmanager
def _stress() -> Iterator[None]:
    """Put the machine under load: two busy cores, memory, disk and sync."""
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder:
        process = subprocess.Popen(["stress-ng", *LOAD, "--temp-path", folder, "--quiet"])
        try:
            time.sleep(STRESS_SETTLE_S)
            yield
        finally:
            process.terminate()
            process.wait()
