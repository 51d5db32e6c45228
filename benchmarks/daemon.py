"""A separate daemon for a benchmark: `hapticd run` on the shipped simulated board, in a unique
instance.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from benchmarks.worker import ROOT, environment
from hapticd.client import Client
from hapticd.mailbox import files
from hapticd.settings.toml import shipped

START_S = 30.0


@contextmanager
def running(name: str) -> Iterator[str]:
    """Start a daemon, ready and disabled, and yield its instance; end it afterwards."""
    instance = f"bench-{name}-{os.getpid()}"
    config = shipped("config") / "hapticd.toml"
    command = [
        sys.executable,
        "-m",
        "hapticd",
        "run",
        "--json",
        "--instance",
        instance,
        "--config",
        str(config),
    ]
    process = subprocess.Popen(
        command, env=environment(), cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    )
    try:
        with Client(instance) as client:
            client.wait_for("disabled", START_S)
        yield instance
    finally:
        process.terminate()
        process.wait()
        shutil.rmtree(files.runtime_folder(instance), ignore_errors=True)
