"""Latency from `set` in a script to the first tick that renders it, compared with an empty ZeroMQ
echo between two processes.
"""

import random
import time
from collections.abc import Iterator

from benchmarks import daemon, targets
from benchmarks.blocks import median_quantile
from benchmarks.echo import echo_ns, echoing
from benchmarks.figures import Figure, compared
from benchmarks.records import place
from benchmarks.worker import BenchError
from hapticd.client import Client
from hapticd.core.units import NS_PER_MS
from hapticd.mailbox import files, layout

TARGETS = targets.of("latency")
BLOCKS = 6
SAMPLES = 200
WARM_UP = 30
PAUSE_S = (0.001, 0.005)  # random, so that no tick of the servo is preferred
ABOVE_ECHO_MS = 1.4
TICK_S = 0.05
STIFFNESS_N_PER_M = (80.0, 120.0)
TICK = place("tick")
TIME_NS = place("time_ns")
TAIL = place("tail")
MESSAGE = bytes(60)


def measure() -> Iterator[Figure]:
    """Yield medians over blocks of p50 and p99; one `set` and one echo in turns."""
    draw = random.Random(1)
    with daemon.running("latency") as instance, Client(instance) as client, echoing() as echo:
        client.enable()
        page = files.open_map(
            files.runtime_folder(instance) / files.TELEMETRY, layout.TELEMETRY_BYTES, writable=False
        )

        def one() -> tuple[float, float]:
            time.sleep(draw.uniform(*PAUSE_S))
            taken = _set_ns(client, memoryview(page), draw.choice(STIFFNESS_N_PER_M))
            time.sleep(draw.uniform(*PAUSE_S))
            return taken / NS_PER_MS, echo_ns(echo, MESSAGE) / NS_PER_MS

        for _ in range(WARM_UP):
            one()
        pairs = [zip(*(one() for _ in range(SAMPLES)), strict=True) for _ in range(BLOCKS)]
        ours, echoes = zip(*pairs, strict=True)
    echo_ms = median_quantile(echoes, 0.99)
    yield compared(
        "set_p50_ms",
        TARGETS["set_p50_ms"],
        median_quantile(ours, 0.5),
        "ms",
        median_quantile(echoes, 0.5),
    )
    yield compared(
        "set_p99_ms",
        f"<= {echo_ms + ABOVE_ECHO_MS:.3f}",
        median_quantile(ours, 0.99),
        "ms",
        echo_ms,
    )


def _set_ns(client: Client, ring: memoryview, stiffness: float) -> int:
    """Return the recorded time of the first tick with `stiffness`, minus the time of sending."""
    asked_ns = time.monotonic_ns()
    tick = client.set(K=stiffness, ramp_s=0.0).first_tick
    deadline = time.monotonic() + TICK_S
    place = layout.TELEMETRY_OFFSET + tick % layout.RING_RECORDS * layout.RECORD.size
    while time.monotonic() < deadline:
        record = layout.RECORD.unpack_from(ring, place)
        if record[TICK] == record[TAIL] == tick:
            return int(record[TIME_NS]) - asked_ns
    raise BenchError(
        f"tick {tick} of the receipt is not in the ring after {TICK_S} s; the servo was paused or"
        " has ended"
    )
