"""Cost of a verb at the shell: `hapticd set` and `hapticd stop` compared with a Python that only
sends one ZeroMQ message and waits for its echo, started in turns.
"""

import subprocess
import sys
import time
from collections.abc import Iterator, Sequence

from benchmarks import daemon, targets
from benchmarks.blocks import median_quantile
from benchmarks.echo import echoing_at
from benchmarks.figures import Figure, compared
from benchmarks.worker import ROOT, BenchError, environment
from hapticd.core.units import NS_PER_MS

TARGETS = targets.of("cli_verbs")
BLOCKS = 5
SAMPLES = 12
BARE = """
import sys, zmq
socket = zmq.Context().socket(zmq.DEALER)
socket.connect(sys.argv[1])
socket.send(b"echo")
socket.recv()
"""


def measure() -> Iterator[Figure]:
    """Yield ratios of medians; each round starts every command once."""
    with daemon.running("verbs") as instance, echoing_at() as endpoint:
        here = [sys.executable, "-m", "hapticd"]
        commands = {
            "bare": [sys.executable, "-c", BARE, endpoint],
            "set": [*here, "set", "K=100", "--instance", instance],
            "stop": [*here, "stop", "--instance", instance],
        }
        for command in commands.values():
            _taken_ms(command)  # to cache the files
        rounds = [
            [{name: _taken_ms(one) for name, one in commands.items()} for _ in range(SAMPLES)]
            for _ in range(BLOCKS)
        ]

    def middle_ms(name: str) -> float:
        return median_quantile([[one[name] for one in block] for block in rounds], 0.5)

    bare_ms = middle_ms("bare")
    for name in ("set", "stop"):
        figure = f"cli_{name}_ratio"
        yield compared(figure, TARGETS[figure], middle_ms(name), "ms", bare_ms)


def _taken_ms(command: Sequence[str]) -> float:
    """Return the wall time of one process, from start to end. BenchError if it fails."""
    begin_ns = time.monotonic_ns()
    done = subprocess.run(command, env=environment(), cwd=ROOT, capture_output=True, text=True)
    taken_ms = (time.monotonic_ns() - begin_ns) / NS_PER_MS
    if done.returncode:
        raise BenchError(f"{' '.join(command[:5])}: {done.stderr.strip()}")
    return taken_ms
