"""Examples in processes of their own, on the virtual board."""

import os
import subprocess
import sys

from support.tree import ROOT

EXAMPLES = ROOT / "examples"


def virtual(name, folder, *words):
    """Return the lines that an example prints on the virtual board, in a separate process."""
    done = subprocess.run(
        [sys.executable, EXAMPLES / f"{name}.py", "--virtual", *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.splitlines()
