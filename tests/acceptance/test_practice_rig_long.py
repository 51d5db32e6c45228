"""The practice rig: verbs of `hapticd rig` on a rig whose truth is in no file that they read."""

import json
from pathlib import Path

import pytest
from practice_rig import SEED, lay_out, quick

from hapticd.settings.load import load


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("hapticd.rig.steps.link.SECONDS", 1.0)
    lay_out(tmp_path)
    (tmp_path / SEED).write_text("77")
    return tmp_path


@pytest.mark.slow
def test_encoder_and_motor_are_measured_by_their_verbs_one_after_the_other(folder, capsys):
    """As somebody types them; each one sees what the one before has written."""
    assert quick(folder, ["rig", "encoder", "--distance", "0.01", "--yes", "--json"]) == 0
    told = capsys.readouterr().out
    (scale,) = [
        one
        for one in json.loads(told[told.index("{") :])["values"]
        if one["name"] == "position.m_per_count"
    ]
    assert load(folder / "hapticd.toml").device.position.m_per_count == pytest.approx(
        scale["value"], rel=1e-3
    )
    assert quick(folder, ["rig", "motor", "--yes"]) == 0
    assert load(folder / "hapticd.toml").device.commissioning.signs_verified
