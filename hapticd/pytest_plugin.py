"""Fixtures for tests of your own scripts; pytest finds them wherever hapticd is installed.

    def test_my_script(hapticd_daemon):          a daemon on the simulated board, in processes
        with hapticd_daemon.client() as device:
            my_script(device)

    def test_my_controller(hapticd_board):       the same stack on virtual time, in this process
        hapticd_board.set(K=100)
        hapticd_board.enable()
        hapticd_board.run(1000)                  ticks; no time passes outside
        assert hapticd_board.newest["stiffness_n_per_m"] == 100

`hapticd_board` is a Client too, so most scripts run on either; it is deterministic and faster than
real time: its virtual time goes on only while it is run, streamed or recorded. Both take the
configuration that the fixture `hapticd_config` names: overwrite it to have your own.

On virtual time, a script must not read a clock.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from hapticd.client import Client
    from hapticd.run.virtual import VirtualBoard

ENDED_S = 20.0


class DaemonProcess:
    """`hapticd run` in a runtime folder of its own; `environment` is what other processes need to
    find it under its default name.
    """

    def __init__(self, folder: Path, config: Path | None) -> None:
        self.folder = folder
        self.environment = {**os.environ, "XDG_RUNTIME_DIR": str(folder)}
        self.environment.pop("RUNTIME_DIRECTORY", None)
        words = ["--config", str(config)] if config else []
        self._log = folder / "log"
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "hapticd", "run", "--json", *words],
                stdout=subprocess.PIPE,
                stderr=log,
                env=self.environment,
            )

    def wait_ready(self) -> None:
        """Until servo and gateway are there. RuntimeError with what it said if they never are."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if json.loads(line).get("event") == "ready":
                return
        raise RuntimeError(f"hapticd did not start:\n{self._log.read_text()}")

    def client(self, name: str = "test", timeout_s: float = 10.0) -> "Client":
        """A client of it."""
        from hapticd.client import Client

        return Client(name=name, timeout_s=timeout_s, folder=self.folder / "hapticd")

    def end(self) -> None:
        """Force fades to 0, and both processes are gone."""
        self._process.terminate()
        self._process.communicate(timeout=ENDED_S)


@pytest.fixture
def hapticd_config() -> Path | None:
    """The configuration to test with; None: the shipped one, of the simulated board."""
    return None


@pytest.fixture
def hapticd_daemon(hapticd_config: Path | None) -> Iterator[DaemonProcess]:
    """A daemon in processes of its own, ready and disabled."""
    # directly in the temporary folder, since a socket's path may have 107 bytes only
    folder = Path(tempfile.mkdtemp(prefix="hapticd-"))
    daemon = DaemonProcess(folder, hapticd_config)
    try:
        daemon.wait_ready()
        yield daemon
    finally:
        daemon.end()
        shutil.rmtree(folder)


@pytest.fixture
def hapticd_board(hapticd_config: Path | None) -> Iterator["VirtualBoard"]:
    """Servo, wire and simulated board on one virtual clock, ready and disabled."""
    from hapticd.run.virtual import virtual_board

    with virtual_board(hapticd_config) as bench:
        yield bench
