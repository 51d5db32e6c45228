"""Programs that tests run next to a daemon, like readers of a page or an example."""

import os
import subprocess
import sys
from pathlib import Path

from hapticd.pytest_plugin import DaemonProcess


def run_beside(
    daemon: DaemonProcess, folder: Path, *words: str | Path, deadline_s: float = 100.0
) -> str:
    """Run `words` in `folder`, with `daemon` as the default daemon; return the output."""
    done = subprocess.run(
        list(map(str, words)),
        cwd=folder,
        env={**daemon.environment, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        timeout=deadline_s,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
