"""The command line without a daemon: what it parses, asks, prints and returns."""

import subprocess
import sys

import pytest


@pytest.mark.process
def test_a_verb_at_the_shell_loads_neither_arrays_nor_models() -> None:
    """Half of the time of `hapticd set` went into numpy and verbs that nobody had asked for, then
    as much into pydantic, which Typer 0.29 loads to read any argument.
    """
    script = (
        "import sys; from hapticd.cli.app import main;"
        " main(['set', 'K=1', '--instance', 'nobody']); print(*sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split())
    assert not {"numpy", "pydantic", "hapticd.cli.zwidth", "hapticd.cli.rig"} & loaded
