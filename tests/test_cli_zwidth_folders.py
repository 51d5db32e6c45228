"""Folders of `hapticd zwidth`: what an interruption leaves, one run a folder, what `report`
draws where, Z(f) for others.
"""

import csv
import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.measured_scenes import GRID_OF_27, RIGID

from hapticd.cli.app import main
from hapticd.cli.zwidth.common import scene_of
from hapticd.settings.toml import shipped
from hapticd.zwidth.portable import device_hash

pytest.importorskip("matplotlib")

SHORT = ["--seconds", "20"]
LIMITS = ["limits", *SHORT, "--axis", "BM", "--damping", "0", "--no-plot"]
MAP = [
    "map",
    *SHORT,
    "--damping",
    "1.74",
    *GRID_OF_27,
    "--no-plot",
]


def run(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    """(exit code, stdout, stderr)"""
    code = main(["zwidth", *arguments])
    told = capsys.readouterr()
    return code, told.out, told.err


def interrupted(*_: Any, **__: Any) -> None:
    raise KeyboardInterrupt


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


@pytest.mark.parametrize("verb", ["trial", "walls"])
def test_interrupted_run_says_that_nothing_is_kept(
    verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from hapticd.zwidth import trial, walls

    monkeypatch.setattr(trial, "run_trial", interrupted)
    monkeypatch.setattr(walls, "run_walls", interrupted)
    code, _, err = run([verb, "--out", str(tmp_path / "x")], capsys)
    assert (code, err.splitlines()[-1]) == (130, "interrupted: nothing of this run was kept")
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    "words",
    [
        ["trial", "--seconds", "8", "--plot"],
        ["walls", "--stiffness", "50", "100", "2", "--viscous", "0", "2", "2", "--damping", "0"],
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
    from hapticd.report import style

    monkeypatch.setattr(style, "save", interrupted)
    code, _, err = run([*words, "--out", str(tmp_path)], capsys)
    assert code == 130
    assert err.endswith(
        f"interrupted: the result is kept in {tmp_path}, without all of its figures\n"
    )
    assert (tmp_path / "run.json").is_file()


# --- one run a folder -----------------------------------------------------------------------------


def test_folder_never_mixes_two_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["trial", "--seconds", "8", "--out", str(tmp_path)]
    run([*words, "--admittance"], capsys)
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


def test_impedance_is_written_for_other_programs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from hapticd.analysis.impedance import impedance
    from hapticd.analysis.spectra import spa
    from hapticd.zwidth.recorded import read_file

    assert run(["trial", "--seconds", "8", "--out", str(tmp_path)], capsys)[0] == 0
    with (tmp_path / "impedance.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    assert head == [
        "frequency_hz",
        "real_ns_per_m",
        "imaginary_ns_per_m",
        "sd_ns_per_m",
        "coherence",
    ]
    found = np.array([[float(cell or "inf") for cell in row] for row in rows])
    record = read_file(tmp_path / "record.h5")
    own = impedance(spa(record.force_n, record.velocity_m_per_s, record.rate_hz))
    band = (own.frequency_hz >= 2.0) & (own.frequency_hz <= 500.0)
    assert found[:, 0] == pytest.approx(own.frequency_hz)
    assert found[band, 1] + 1j * found[band, 2] == pytest.approx(
        own.impedance_ns_per_m[band], rel=1e-3
    )
    assert found[band, 3] == pytest.approx(own.sd_ns_per_m[band], rel=1e-3)
    assert found[band, 4] == pytest.approx(own.coherence[band], rel=1e-3)


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


@pytest.mark.parametrize(
    ("file", "said"),
    [
        (
            "trials.jsonl",
            (
                "an unfinished run, whose trials are kept; repeat the command that began it with"
                " --out {} to finish and draw it"
            ),
        ),
        (
            "table.json",
            (
                "the paper, reproduced, with its figures in REPORT.md; make it again: `hapticd"
                " zwidth reproduce --out {}`"
            ),
        ),
        (
            "anything",
            (
                "no run folder: it has no run.json; name a simulated device, a scene, or the folder"
                " of a trial or a map"
            ),
        ),
    ],
)
def test_report_says_what_a_folder_is(
    file: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / file).touch()
    code, _, err = run(["report", str(tmp_path)], capsys)
    assert code == 78
    assert f"{tmp_path}: {said.format(tmp_path)}" in err
    assert "scene: no such" not in err


@pytest.mark.parametrize("kind", ["limits", "search", "walls", "report"])
def test_run_that_is_drawn_by_its_own_command_says_so(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run.json").write_text(json.dumps({"kind": kind}))
    code, _, err = run(["report", str(tmp_path)], capsys)
    assert code == 78
    assert (
        f"{tmp_path}: a run of kind '{kind}' can only be redrawn by the command that made it"
        f" (--out {tmp_path}); this verb redraws trials and maps" in err
    )


def test_interrupted_report_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from hapticd.zwidth import map

    monkeypatch.setattr(map, "run_map", interrupted)
    code, _, err = run(
        ["report", "weir2008", *SHORT, "--damping", "1.74", "--out", str(tmp_path)], capsys
    )
    kept = len(set((tmp_path / "trials.jsonl").read_text().splitlines()))
    assert code == 130
    assert (
        f"{kept} trials are kept in {tmp_path}; the same command with --out {tmp_path} goes on"
        " there" in err
    )


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
        main(["zwidth", "report", "own.toml", "--seconds", "4", "--damping", "0", "--out", "out"])
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
