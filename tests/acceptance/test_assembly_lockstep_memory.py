"""A million ticks grow no memory: a process of its own, so that nothing else allocates beside
it.
"""

import subprocess
import sys

import pytest
from support.tree import TESTS


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_million_ticks_grow_no_memory():
    command = [sys.executable, "-m", "support.million_ticks"]
    done = subprocess.run(command, cwd=TESTS, capture_output=True, text=True, check=True)
    growth_kb, ticks, state = done.stdout.split()
    assert int(ticks) > 1_100_000
    assert state == "ENABLED"
    assert int(growth_kb) <= 32  # in half of them
