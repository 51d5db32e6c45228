"""Every tick of a minute at 1 kHz, in five processes at once, and the cost for the gateway.

The yardstick is a minimal forwarder at the same time: it reads the same ring, packs the same maps
and sends them to five minimal subscribers. The gateway's additional work is the inspection of every
record: histograms, events, the flight recorder.
"""

import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

from benchmarks import daemon, targets
from benchmarks.figures import Figure, compared
from benchmarks.worker import BenchError, next_json, started
from hapticd.client import Client
from hapticd.core.units import NS_PER_S

TARGETS = targets.of("telemetry")
SUBSCRIBERS = 5
RECORDED_S = 60
LEAST = 0.9
SUBSCRIBER = "a subscriber"  # in messages


def measure() -> Iterator[Figure]:
    """Yield the records missing in any of the five, and the CPU time of gateway and forwarder while
    all are subscribed.
    """
    with daemon.running("telemetry") as instance, ExitStack() as stack:
        with Client(instance) as client:
            client.enable()
            gateway = int(client.status().gateway["pid"])
        endpoint = f"ipc://{stack.enter_context(tempfile.TemporaryDirectory(prefix='hapticd-bench-'))}/bare"
        forwarder = _started(stack, "forward_worker", ["forward", instance, endpoint])
        listeners = [
            _started(stack, "telemetry_worker", [instance, str(RECORDED_S)])
            for _ in range(SUBSCRIBERS)
        ]
        bare = [
            _started(stack, "forward_worker", ["listen", endpoint, str(RECORDED_S)])
            for _ in range(SUBSCRIBERS)
        ]
        for one in (*listeners, *bare):
            next_json(one, SUBSCRIBER)
        before = (cpu_s(gateway), cpu_s(forwarder.pid))
        begin = time.monotonic()
        results = [next_json(listener, SUBSCRIBER) for listener in listeners]
        took_s = time.monotonic() - begin
        after = (cpu_s(gateway), cpu_s(forwarder.pid))
        forwarded = min(next_json(one, SUBSCRIBER)["records"] for one in bare)
    got = min(result["records"] for result in results)
    if forwarded < LEAST * got:
        raise BenchError(
            f"the bare forwarder passed on {forwarded} records while the gateway sent {got}; quiet"
            " the machine"
        )
    ours, theirs = (
        100.0 * (end - start) / took_s for start, end in zip(before, after, strict=True)
    )
    note = f"{SUBSCRIBERS} subscribers, {got} records each at least"
    yield compared(
        "telemetry_gaps",
        TARGETS["telemetry_gaps"],
        sum(result["missing"] for result in results),
        "records",
        note=note,
    )
    yield compared(
        "gateway_cpu_ratio", TARGETS["gateway_cpu_ratio"], ours, "%", theirs, "of a core"
    )


def cpu_s(pid: int) -> float:
    """Return the CPU time of process `pid` so far, of all its threads, from the scheduler."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((task / "schedstat").read_text().split()[0]) for task in tasks) / NS_PER_S


def _started(stack: ExitStack, module: str, arguments: Sequence[str]) -> "subprocess.Popen[bytes]":
    process = started(module, arguments)
    stack.callback(process.communicate)
    stack.callback(process.kill)
    return process
