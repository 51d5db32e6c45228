"""Files that older versions wrote (tests/data) stay readable."""

import shutil
from pathlib import Path

import pytest

from hapticd.cli.app import main

pytest.importorskip("matplotlib")

OLD = Path(__file__).parent / "data" / "as-of-0.1"


@pytest.mark.parametrize("kind", ["map", "trial"])
def test_an_old_run_folder_is_drawn_again(kind, tmp_path, capsys):
    folder = shutil.copytree(OLD / kind, tmp_path / kind)
    assert main(["zwidth", "report", str(folder)]) == 0, capsys.readouterr().err
    assert list(folder.glob("*.png"))


def test_an_old_recording_opens_and_is_replayed(tmp_path, capsys):
    recording = shutil.copy(OLD / "recording.h5", tmp_path / "recording.h5")
    assert main(["rec", "info", str(recording)]) == 0
    assert "3001 records, 12004 probe samples" in capsys.readouterr().out
    assert main(["replay", str(recording)]) == 0, capsys.readouterr().err
