"""Files that older versions wrote (tests/support/data) stay readable."""

import json
import shutil

import pytest
from support.old_files import OLD

from hapticd.cli.app import main
from hapticd.zwidth import outcomes


@pytest.mark.parametrize("kind", ["map", "trial"])
def test_an_old_run_folder_is_drawn_again(kind, tmp_path, capsys):
    folder = shutil.copytree(OLD / kind, tmp_path / kind)
    assert main(["zwidth", "report", str(folder)]) == 0, capsys.readouterr().err
    assert list(folder.glob("*.png"))


def test_an_old_map_is_drawn_of_its_own_trials_and_says_where_they_were_judged(
    tmp_path, capsys, monkeypatch
):
    """No trial is flown again, and none is said to have been judged at 2 Hz."""

    def flown(*_, **__):
        raise AssertionError("a report flies nothing")

    monkeypatch.setattr(outcomes, "simulate", flown)
    folder = shutil.copytree(OLD / "map", tmp_path / "map")
    assert main(["zwidth", "report", str(folder)]) == 0
    assert "first judged 2.93 Hz, last judged 500 Hz\n" in capsys.readouterr().out
    assert (folder / "trials.jsonl").read_bytes() == (OLD / "map" / "trials.jsonl").read_bytes()
    for figure in ("set.svg", "envelope.svg"):
        assert "judged 2.93 to 500 Hz" in (folder / figure).read_text()
    assert main(["zwidth", "report", str(folder), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["judged"]
    assert told == {"first_hz": 3 * 4000 / 4096, "last_hz": 500.0}


def test_an_old_trial_is_judged_again_at_its_edges(tmp_path, capsys):
    folder = shutil.copytree(OLD / "trial", tmp_path / "trial")
    assert main(["zwidth", "report", str(folder)]) == 0
    assert "first judged 2.00 Hz, last judged 500 Hz\n" in capsys.readouterr().out
    assert "judged 2.00 to 500 Hz" in (folder / "trial.svg").read_text()
