"""Scenes as the bench takes them: which are linear, and at which frequencies they are judged."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hapticd.settings.scene import load_scene
from hapticd.settings.toml import shipped
from hapticd.zwidth.sources import frequencies, scene_of_device


def test_only_scenes_without_nonlinearity_are_linear() -> None:
    assert load_scene("theory").is_linear
    assert not load_scene("fig7").is_linear
    assert not replace(load_scene("theory"), environment=load_scene("wall").environment).is_linear


def test_frequencies_lie_on_the_grid_of_the_papers_window() -> None:
    f = frequencies((2.0, 500.0))
    assert np.allclose(f / (2000.0 / 2048), np.rint(f / (2000.0 / 2048)))
    assert (f[0] >= 2.0, f[-1] <= 500.0) == (True, True)
    assert (np.diff(f) > 0.0).all()


def test_the_device_of_the_configuration_is_known_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A model that `hapticd rig identify` wrote predicts its own display, not a shipped one."""
    (tmp_path / "devices").mkdir()
    text = (shipped("config") / "devices" / "weir2008.toml").read_text()
    name = next(line for line in text.splitlines() if line.startswith("name = "))
    own = text.replace(name, 'name = "mine"', 1)
    (tmp_path / "devices" / "own.toml").write_text(own)
    (tmp_path / "hapticd.toml").write_text('device = "own"\n')
    monkeypatch.setenv("HAPTICD_CONFIG", str(tmp_path / "hapticd.toml"))
    assert scene_of_device("mine").device == "own"
    monkeypatch.setenv("HAPTICD_CONFIG", str(tmp_path / "nothing.toml"))
    assert scene_of_device("mine") is None
    shipped_name = name.partition('"')[2].partition('"')[0]
    assert scene_of_device(shipped_name).device == "weir2008"
