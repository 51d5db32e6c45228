"""Cost for the console of showing a browser every tick, 50 frames a second.

The yardstick gets exactly the console's messages, at the same time. A reader of the page's socket
publishes its messages. A minimal forwarder, asyncio like the console's server, sends each of them
on to its own websocket. The console's additional work is making frames from the records, following
the daemon in a thread, and acknowledgements.
"""

import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack

from benchmarks import daemon, targets
from benchmarks.figures import Figure, compared
from benchmarks.telemetry import cpu_s
from benchmarks.worker import BenchError, next_json, started
from hapticd.mailbox.daemons import console_place, daemon_folder

TARGETS = targets.of("page_cpu")
BLOCKS = 6
BLOCK_S = 5.0
SETTLING_S = 8.0  # until the plane of a new page is computed
RATE_HZ = 50.0
LEAST_SHARE = 0.9  # of the expected frames


def measure() -> Iterator[Figure]:
    """Yield the CPU time of console and forwarder while each has one reader."""
    with daemon.running("page") as instance, ExitStack() as stack:
        place = page_of(instance)
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="hapticd-bench-"))
        endpoint = f"ipc://{folder}/frames"
        forwarder = worker(stack, "forward", endpoint)
        bare_url = next_json(forwarder, "the bare forwarder")["url"]
        seconds = str(SETTLING_S + BLOCKS * BLOCK_S)
        live_url = f"{place['url'].replace('http:', 'ws:')}live"
        page = worker(stack, "read", live_url, seconds, endpoint)
        bare = worker(stack, "read", bare_url, seconds)
        time.sleep(SETTLING_S)
        pids = (int(place["pid"]), forwarder.pid)
        shares = [_shares(pids) for _ in range(BLOCKS)]
        frames, forwarded = (next_json(one, "a reader")["frames"] for one in (page, bare))
    wanted = LEAST_SHARE * RATE_HZ * (SETTLING_S + BLOCKS * BLOCK_S)
    if min(frames, forwarded) < wanted:
        raise BenchError(
            f"{frames} frames of the console and {forwarded} of the forwarder came, {wanted:.0f}"
            " should; quiet the machine"
        )
    ours, theirs = (100.0 * sum(one) / BLOCKS for one in zip(*shares, strict=True))
    target = TARGETS["page_cpu_ratio"]
    yield compared("page_cpu_ratio", target, ours, "%", theirs, f"of a core; {frames} frames")


def page_of(instance: str) -> dict[str, object]:
    """Return the address of the page of `instance`, {url, port, pid}. BenchError if it does not
    appear.
    """
    deadline = time.monotonic() + daemon.START_S
    while (place := console_place(daemon_folder(instance))) is None:
        if time.monotonic() > deadline:
            raise BenchError(f"no page of {instance} after {daemon.START_S} s")
        time.sleep(0.1)
    return place


def _shares(pids: Sequence[int]) -> list[float]:
    """Return the shares of a core used by the processes in one block."""
    before = [cpu_s(pid) for pid in pids]
    begin = time.monotonic()
    time.sleep(BLOCK_S)
    took_s = time.monotonic() - begin
    return [(cpu_s(pid) - old) / took_s for pid, old in zip(pids, before, strict=True)]


def worker(stack: ExitStack, *arguments: str) -> "subprocess.Popen[bytes]":
    """Start a process of `page_worker` that ends with `stack`."""
    process = started("page_worker", arguments)
    stack.callback(process.communicate)
    stack.callback(process.kill)
    return process
