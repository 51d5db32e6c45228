"""Python on the pages of users runs as it stands, on a daemon with the simulated board."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from support.daemon import until
from support.tree import ROOT

from hapticd.pytest_plugin import DaemonProcess

pytestmark = pytest.mark.process
DEADLINE_S = 100.0
NO_VERDICT = 3
RUN = f"""
import runpy, sys
from hapticd.client import CommandError
try:
    runpy.run_path("program.py")
except CommandError as error:
    if error.guard is None or error.guard.safe is not None:
        raise
    sys.exit({NO_VERDICT})
"""


@pytest.fixture
def hapticd_config(tmp_path: Path) -> Path:
    """A host that may be busy: the real-time rights of the machine are not asked for."""
    path = tmp_path / "hapticd.toml"
    path.write_text('[realtime]\nmode = "off"\n[gateway]\ntelemetry_port = 0\n')
    return path


def programs(page: str) -> list[str]:
    """The Python blocks of a page that are whole programs."""
    text = (ROOT / "docs" / page).read_text()
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return [block for block in blocks if "import " in block]


@pytest.mark.parametrize(
    "page", ["quickstart.md", "guard.md", "leases.md", "custom-environments.md", "zwidth.md"]
)
def test_programs_of_the_page_run(page: str, hapticd_daemon: DaemonProcess, tmp_path: Path) -> None:
    (program,) = programs(page)
    with hapticd_daemon.client() as device:
        device.damping("on")
    until(lambda: ran(program, hapticd_daemon, tmp_path), page)


def ran(program: str, daemon: DaemonProcess, folder: Path) -> bool:
    """Whether `program` ran to its end, and not to a change on which the guard had no verdict, as
    on a busy computer.
    """
    (folder / "program.py").write_text(program)
    done = subprocess.run(
        [sys.executable, "-c", RUN],
        cwd=folder,
        env={**daemon.environment, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
    )
    assert done.returncode in (0, NO_VERDICT), done.stderr
    return done.returncode == 0
