"""The operators' page without a browser: what waits for one, who may talk to it, what is sent, and
the one file that is not ours.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from support.daemon import until


@pytest.mark.process
@pytest.mark.usefixtures("runtime")
def test_a_verb_that_is_tied_ends_with_its_parent() -> None:
    """A parent that is killed says nothing to anybody; the verb is one that needs no daemon."""
    tied = [sys.executable, "-m", "hapticd.console.tied"]
    program = f"""
import os, subprocess, time
child = subprocess.Popen({tied!r} + [str(os.getpid()), "console", "--instance", "nobody", "--json"])
print(child.pid, flush=True)
time.sleep(600)
"""
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        child = Path("/proc") / parent.stdout.readline().strip()
        assert json.loads(parent.stdout.readline())["ok"]  # it serves
        parent.kill()
    until(lambda: not child.exists(), "its end")
