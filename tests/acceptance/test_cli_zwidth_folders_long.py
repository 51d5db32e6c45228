"""Folders of `hapticd zwidth`: what an interruption leaves, one run a folder, what `report`
draws where, Z(f) for others.
"""

import hashlib
import json
import shutil
from math import inf
from pathlib import Path

import pytest
from support.cli_zwidth_folders import LIMITS, MAP, SHORT, interrupted, run
from support.measured_scenes import RIGID

from hapticd.cli.app import main
from hapticd.cli.zwidth.common import scene_of
from hapticd.settings.toml import shipped
from hapticd.zwidth.portable import device_hash


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


# --- Ctrl-C ---------------------------------------------------------------------------------------


def test_interrupted_limits_go_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from hapticd.cli.zwidth import common

    with monkeypatch.context() as patch:
        patch.setattr(common, "print_outcomes", interrupted)
        code, _, err = run([*LIMITS, "--json", "--out", str(tmp_path)], capsys)
    assert code == 130
    kept = len((tmp_path / "trials.jsonl").read_text().splitlines())
    assert (
        err
        == f"{kept} trials are kept in {tmp_path}; the same command with --out {tmp_path} goes on"
        " there\n"
    )
    assert names(tmp_path) == {"trials.jsonl"}
    code, out, _ = run([*LIMITS, "--json", "--out", str(tmp_path)], capsys)
    resumed = json.loads(out.splitlines()[-1])
    assert code == 0
    assert resumed["made"] == len(out.splitlines()) - 1
    _, out, _ = run([*LIMITS, "--json", "--out", str(tmp_path / "whole")], capsys)
    whole = json.loads(out.splitlines()[-1])
    assert resumed["limits"] == whole["limits"]
    assert resumed["made"] < whole["made"]
    _, out, _ = run([*LIMITS, "--out", str(tmp_path)], capsys)
    assert "\n0 trials made\n" in out


# --- one run a folder -----------------------------------------------------------------------------


def test_folder_never_mixes_two_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["trial", "--seconds", "8", "--out", str(tmp_path)]
    run([*words, "--plot"], capsys)
    (tmp_path / "notes.png").write_text("mine")
    (tmp_path / "trials.jsonl").write_text('{"key": "a"}\n')
    assert {"trial.png", "trial_admittance.svg"} <= names(tmp_path)
    assert run([*words, "--seed", "2"], capsys)[0] == 0
    assert names(tmp_path) == {
        "run.json",
        "record.h5",
        "impedance.csv",
        "notes.png",
        "trials.jsonl",
    }
    assert run([*LIMITS, "--out", str(tmp_path)], capsys)[0] == 0
    assert names(tmp_path) == {"run.json", "notes.png", "trials.jsonl"}


# --- report ---------------------------------------------------------------------------------------


def test_report_draws_a_run_where_it_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(["trial", "--seconds", "8", "--out", str(tmp_path / "a")], capsys)
    before = names(tmp_path / "a")
    assert run(["report", str(tmp_path / "a"), "--out", str(tmp_path / "drawn")], capsys)[0] == 0
    assert names(tmp_path / "a") == before
    assert "trial.png" in names(tmp_path / "drawn")
    run([*MAP, "--out", str(tmp_path / "m")], capsys)
    code, out, _ = run(
        ["report", str(tmp_path / "m"), "--out", str(tmp_path / "drawn_too")], capsys
    )
    assert code == 0
    assert "set.png" in names(tmp_path / "drawn_too")
    assert str(tmp_path / "drawn_too" / "set.png") in out
    assert names(tmp_path / "m") == {"run.json", "trials.jsonl"}


def test_report_of_a_device_of_ones_own_is_written(tmp_path, capsys, monkeypatch):
    """A scene that names a device beside it, and that device's file itself: the summary belongs
    to that file.
    """
    file = tmp_path / "devices" / "mine.toml"
    file.parent.mkdir()
    shutil.copy(shipped("config") / "devices" / "ideal.toml", file)
    (tmp_path / "own.toml").write_text(RIGID.replace('"ideal"', '"mine"'))
    monkeypatch.chdir(tmp_path)
    assert (
        main(
            [
                "zwidth",
                "report",
                "own.toml",
                "--seconds",
                "4",
                "--active-damping",
                "0",
                "--out",
                "out",
            ]
        )
        == 0
    ), capsys.readouterr().err
    found = json.loads((tmp_path / "out" / "mine.zwidth").read_text())
    assert found["device"] == "mine"
    assert (
        found["device_file_sha256"]
        == hashlib.sha256(file.read_bytes()).hexdigest()
        == device_hash(str(file))
    )
    assert scene_of("devices/mine.toml").device == "mine"


def test_interrupted_report_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from hapticd.zwidth import map

    monkeypatch.setattr(map, "run_map", interrupted)
    code, _, err = run(
        ["report", "weir2008", *SHORT, "--active-damping", "1.74", "--out", str(tmp_path)], capsys
    )
    kept = len(set((tmp_path / "trials.jsonl").read_text().splitlines()))
    assert code == 130
    assert (
        f"{kept} trials are kept in {tmp_path}; the same command with --out {tmp_path} goes on"
        " there" in err
    )


@pytest.mark.parametrize(
    "words",
    [
        ["trial", "--seconds", "8", "--plot"],
        [
            "walls",
            "--stiffness",
            "50",
            "100",
            "2",
            "--viscous",
            "0",
            "2",
            "2",
            "--active-damping",
            "0",
        ],
        [*LIMITS[:-1], "--axis", "B"],
        MAP[:-1],
    ],
)
def test_interrupted_drawing_says_that_the_result_is_kept(
    words: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from hapticd.zwidth.report import style

    monkeypatch.setattr("hapticd.cli.zwidth.map.REDRAW_S", inf)  # on a slow machine it draws before
    monkeypatch.setattr(style, "save", interrupted)
    code, _, err = run([*words, "--out", str(tmp_path)], capsys)
    assert code == 130
    assert err.endswith(
        f"interrupted: the result is kept in {tmp_path}, without all of its figures\n"
    )
    assert (tmp_path / "run.json").is_file()
