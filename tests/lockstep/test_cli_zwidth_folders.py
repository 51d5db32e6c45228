"""Folders of `hapticd zwidth`: what an interruption leaves, one run a folder, what `report`
draws where, Z(f) for others.
"""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from support.cli_zwidth_folders import interrupted, run


@pytest.mark.parametrize("verb", ["trial", "walls"])
def test_interrupted_run_says_that_nothing_is_kept(
    verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from hapticd.zwidth import trial, walls

    monkeypatch.setattr(trial, "run_trial", interrupted)
    monkeypatch.setattr(walls, "run_walls", interrupted)
    code, _, err = run([verb, "--out", str(tmp_path / "x")], capsys)
    assert (code, err.splitlines()[-1]) == (130, "interrupted: no result of this run was stored")
    assert not (tmp_path / "x").exists()


def test_impedance_is_written_for_other_programs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from hapticd.signal.impedance import impedance
    from hapticd.signal.spectra import spa
    from hapticd.zwidth.recorded import read_file

    assert run(["trial", "--seconds", "8", "--out", str(tmp_path)], capsys)[0] == 0
    with (tmp_path / "impedance.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    assert head == [
        "frequency_hz",
        "real_ns_per_m",
        "imaginary_ns_per_m",
        "random_error_sd_ns_per_m",
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
