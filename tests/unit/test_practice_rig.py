"""The practice rig: verbs of `hapticd rig` on a rig whose truth is in no file that they read."""

from pathlib import Path

import pytest
from practice_rig import SEED, lay_out, main

from hapticd.core.errors import ConfigError
from hapticd.settings.load import load


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("hapticd.rig.steps.link.SECONDS", 1.0)
    lay_out(tmp_path)
    (tmp_path / SEED).write_text("77")
    return tmp_path


def test_a_newcomers_folder_is_the_template_with_nothing_measured(folder):
    device = load(folder / "hapticd.toml").device
    assert not device.simulated
    assert device.commissioning is None
    assert device.model is None
    before = (folder / SEED).read_text()
    lay_out(folder)
    assert (folder / SEED).read_text() == before


def test_what_needs_a_daemon_says_so(folder):
    with pytest.raises(ConfigError, match="'guard' needs a daemon: start `make practice`"):
        main([str(folder), "guard"])
