"""Minimum cost of a request between two processes: a ROUTER that returns each message."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager

import zmq

from benchmarks.worker import ROOT, environment


@contextmanager
def echoing_at() -> Iterator[str]:
    """Yield the endpoint of a process that returns each message."""
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder:
        endpoint = f"ipc://{folder}/echo"
        process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.echo_worker", endpoint], env=environment(), cwd=ROOT
        )
        try:
            yield endpoint
        finally:
            process.terminate()
            process.wait()


@contextmanager
def echoing() -> Iterator["zmq.Socket[bytes]"]:
    """Yield a DEALER whose messages are returned."""
    with echoing_at() as endpoint:
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        socket = context.socket(zmq.DEALER)
        socket.setsockopt(zmq.RCVTIMEO, 10_000)
        socket.connect(endpoint)
        try:
            yield socket
        finally:
            context.destroy(linger=100)


def echo_ns(socket: "zmq.Socket[bytes]", message: bytes) -> int:
    """Return the time until `message` is back."""
    begin_ns = time.monotonic_ns()
    socket.send(message)
    socket.recv()
    return time.monotonic_ns() - begin_ns
