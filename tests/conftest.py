"""Fixtures that several files use."""

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from hapticd.mailbox import files


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty runtime folder for this test alone, and no configuration but the shipped one.

    Directly in the temporary folder, since a socket's path may have 107 bytes only.
    """
    folder = Path(tempfile.mkdtemp(prefix="hapticd-test-"))
    for name in ("RUNTIME_DIRECTORY", "HAPTICD_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(folder / "config"))
    monkeypatch.setenv("XDG_STATE_HOME", str(folder / "state"))
    monkeypatch.setattr(files, "SERVICE_FOLDER", folder / "no-service")  # whatever runs on this machine
    yield folder
    shutil.rmtree(folder)
