"""Files that older versions wrote (tests/support/data) stay readable."""

import shutil

from support.old_files import OLD

from hapticd.cli.app import main


def test_an_old_recording_opens_and_is_replayed(tmp_path, capsys):
    recording = shutil.copy(OLD / "recording.h5", tmp_path / "recording.h5")
    assert main(["rec", "info", str(recording)]) == 0
    assert "3001 records, 12004 probe samples" in capsys.readouterr().out
    assert main(["replay", str(recording)]) == 0, capsys.readouterr().err
