"""Examples run as they stand; those that need a daemon are in the process tests."""

import os
import subprocess
import sys

import pytest
from support.examples import EXAMPLES
from support.tree import ROOT


@pytest.mark.parametrize("name", ["sweep", "toggle", "steps", "wall", "jnd", "virtual_coupling"])
def test_every_example_names_the_instance_it_does_not_find(name, tmp_path):
    done = subprocess.run(
        [sys.executable, EXAMPLES / f"{name}.py", "--instance", "nope"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "XDG_RUNTIME_DIR": str(tmp_path)},
        input="",
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode != 0
    assert "hapticd run --instance nope" in done.stderr
