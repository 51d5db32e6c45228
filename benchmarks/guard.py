"""Cost of the guard's worker: whether a path is safe, the margin of a display, and a whole verdict
for the gateway.

    guard_path_ratio     yes or no to 20 points at a kept level: eigenvalues and circles
    guard_margin_ratio   margin, worst frequency and radius of a new display
    guard_proof_ratio    a whole verdict, over one that tests circles at several hundred angles and
                         proves nothing between them; both without a socket
    guard_verdict_ms     a change sent to the worker process over its socket, with margin, allowed
                         ranges and minimum level

The yardstick of the others is an empty ZeroMQ echo between two processes, with the average length
of request and answer. All in turns; every display is new.
"""

import os
import random
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgpack
import zmq

from benchmarks import targets
from benchmarks.blocks import median_quantile
from benchmarks.echo import echo_ns, echoing
from benchmarks.figures import Figure, compared
from benchmarks.worker import ROOT, Worker, environment
from hapticd.core.units import NS_PER_MS
from hapticd.guard.worker import LENGTH
from hapticd.run.supervisor import write
from hapticd.settings.load import Override, load
from hapticd.settings.toml import shipped

TARGETS = targets.of("guard")
DEVICE = "weir2008"
BLOCKS = 6
SAMPLES = 60
FIGURES = {
    "guard_path_ratio": "path",
    "guard_margin_ratio": "margin",
    "guard_verdict_ms": "verdict",
}
LEVEL_NS_PER_M = 1.74
FREE = {"K": 0.0, "B": 0.0, "M": 0.0, "active_damping": LEVEL_NS_PER_M}
REQUEST = {
    "ask": "change",
    "n": 1,
    "now": FREE,
    "target": FREE,
    "state": "enabled",
    "enable": False,
    "before": [],
    "after": [],
    "policy": "refuse",
    "basis": "theorem",
    "margin_ns_per_m": 0.0,
    "mode": "off",
    "level": 0.0,
    "delay_periods": None,
    "ramp_s": 0.05,
}


def measure() -> Iterator[Figure]:
    """Yield medians over blocks of the median of each."""
    asked = Override(("device",), DEVICE, "benchmark")
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as name:
        folder = Path(name)
        write(folder, load(shipped("config") / "hapticd.toml", (asked,)), "bench")
        with _guard(folder) as line, Worker("guard_worker", [name]) as worker, echoing() as echo:
            blocks = _blocks(line, worker, echo)
    echo_ms = median_quantile(blocks["echo"], 0.5)
    for figure, key in FIGURES.items():
        value = median_quantile(blocks[key], 0.5)
        yield compared(figure, TARGETS[figure], value, "ms", echo_ms)
    proven_ms, angles_ms = (median_quantile(blocks[key], 0.5) for key in ("proven", "angles"))
    name = "guard_proof_ratio"
    yield compared(name, TARGETS[name], proven_ms, "ms", angles_ms)


def _blocks(
    line: socket.socket, worker: Worker, echo: "zmq.Socket[bytes]"
) -> dict[str, list[list[float]]]:
    draw = random.Random(1)

    def point() -> dict[str, float]:
        return {"K": draw.uniform(50.0, 500.0), "B": draw.uniform(0.2, 2.0)}

    message = bytes((len(_asked(point())) + len(msgpack.packb(_verdict(line, point())))) // 2)

    def once() -> dict[str, float]:
        change = point()
        begin_ns = time.monotonic_ns()
        _verdict(line, change)
        verdict_ns = time.monotonic_ns() - begin_ns
        return {
            **worker.ask(
                start=FREE,
                end=FREE | point(),
                change=REQUEST | {"change": point()},
                other=REQUEST | {"change": point()},
            ),
            "verdict": verdict_ns / NS_PER_MS,
            "echo": echo_ns(echo, message) / NS_PER_MS,
        }

    for _ in range(SAMPLES):
        once()
    blocks = [[once() for _ in range(SAMPLES)] for _ in range(BLOCKS)]
    return {key: [[one[key] for one in block] for block in blocks] for key in blocks[0][0]}


def _asked(change: dict[str, float]) -> bytes:
    return bytes(msgpack.packb(REQUEST | {"change": change}))


def _verdict(line: socket.socket, change: dict[str, float]) -> Any:
    request = _asked(change)
    line.sendall(LENGTH.pack(len(request)) + request)
    return _receive(line)


def _receive(line: socket.socket) -> Any:
    (size,) = LENGTH.unpack(line.recv(LENGTH.size, socket.MSG_WAITALL))
    return msgpack.unpackb(line.recv(size, socket.MSG_WAITALL))


@contextmanager
def _guard(folder: Path) -> Iterator[socket.socket]:
    """Yield the worker's socket, after its hello."""
    ours, theirs = socket.socketpair()
    command = [sys.executable, "-m", "hapticd.guard.worker", str(folder)]
    process = subprocess.Popen(
        [*command, "--fd", str(theirs.fileno()), "--parent", str(os.getpid())],
        pass_fds=(theirs.fileno(),),
        env=environment(),
        cwd=ROOT,
    )
    theirs.close()
    ours.settimeout(30.0)
    try:
        _receive(ours)
        yield ours
    finally:
        ours.close()
        process.wait()
