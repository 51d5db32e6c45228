"""What a checkout installs: pins within their ranges, and what happens where a program is
missing.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.tree import ROOT


@pytest.fixture
def ordinary_user(tmp_path: Path) -> dict[str, str]:
    """Environment of someone without root, sudo, and the programs that tests need."""
    commands = {"id": "echo 1000", "apt-get": "exit 1", "dpkg": "exit 1"}
    for name, body in commands.items():
        (tmp_path / name).write_text(f"#!/bin/bash\n{body}\n")
        (tmp_path / name).chmod(0o755)
    return {**os.environ, "PATH": str(tmp_path), "PYTHON": sys.executable, "CC": ""}


@pytest.mark.parametrize(("options", "code"), [((), 0), (("--all-must-run",), 1)])
def test_missing_program_skips_its_tests_or_fails_the_run(
    ordinary_user: dict[str, str], options: tuple[str, ...], code: int
) -> None:
    pytest_command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *options]
    command = [*pytest_command, "tests/lockstep/test_systemd.py", "-k", "verify"]
    done = subprocess.run(command, cwd=ROOT, env=ordinary_user, capture_output=True, text=True)
    assert (done.returncode, "1 skipped" in done.stdout) == (code, True), done.stdout
    assert "systemd-analyze is missing; install it with `make deps`" in done.stdout
    assert ("not run, and every test has to" in done.stdout) == bool(options)
