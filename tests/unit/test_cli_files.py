"""File names that are wrong: a usage error, with the name that was meant where there is one."""

import json
from pathlib import Path

import pytest
from support.client_double import ClientDouble

from hapticd.cli import change, daemon, recording
from hapticd.cli.app import main


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with one recording in it."""
    double = ClientDouble()
    for module in (change, daemon, recording):
        monkeypatch.setattr(module, "connect", lambda instance, timeout_s=2.0: double)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run1.h5").touch()
    return tmp_path


MISSING = "no such file; check the path and its permissions"
MISTAKES = {
    "rec info nothere.h5": f"nothere.h5: {MISSING}",
    "rec info run2.h5": f"run2.h5: {MISSING}; did you mean 'run1.h5'?",
    "rec recover nothere.part.h5": MISSING,
    "rec export mat nothere.h5": MISSING,
    "replay nothere.h5": MISSING,
    "perturb load nothere.txt": MISSING,
    "zwidth import nothere.csv": f"nothere.csv: {MISSING}",
    "zwidth import run1.h5 --align nothere.h5": f"nothere.h5: {MISSING}",
    "zwidth trial nothere.csv --no-plot": f"nothere.csv: {MISSING}",
    "zwidth trial liv --no-plot": (
        "'liv' is not engine, lockstep, live or a file; did you mean 'live'?"
    ),
    "zwidth trial Engine --no-plot": "did you mean 'engine'?",
    "record run1.csv": "run1.csv: a recording is called NAME.h5: run1.h5",
}


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("words", MISTAKES)
def test_wrong_name_is_a_usage_error(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*words.split(), "--json"]) == 2
    error = json.loads(capsys.readouterr().out)["error"]
    assert error["code"] == "usage"
    assert MISTAKES[words] in error["message"]


def test_record_of_one_row_is_called_that(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It has a time, so that its rate is not what it lacks."""
    (folder / "few.csv").write_text("time,force_n,velocity_m_per_s\n0.0,0.1,0.2\n")
    assert main(["zwidth", "import", "few.csv"]) == 65
    assert "few.csv has one row of numbers" in capsys.readouterr().err
