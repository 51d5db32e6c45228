"""What this package writes it reads: a recording, its exports and a trial's record, with rate,
units, badge and environment.
"""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from hapticd.cli.app import main
from hapticd.core.environment import Environment
from hapticd.core.errors import AnalysisError, ConfigError
from hapticd.settings.scene import load_scene
from hapticd.zwidth.recorded import read_file
from hapticd.zwidth.sources import given


def test_short_recording_says_that_it_is_too_short(recording_file, tmp_path, capsys):
    file = shutil.copy(recording_file, tmp_path / "short.h5")
    assert main(["zwidth", "import", str(file)]) == 65
    told = capsys.readouterr().err
    assert "as recorded in K " in told
    assert re.search(r"short\.h5 of .* s are too short for a verdict", told), told


@pytest.mark.parametrize("name", ["trial", "trial/record.h5"])
def test_run_folder_and_its_record_come_back_as_they_were(name, tmp_path, capsys):
    words = ["-K", "100", "-B", "1", "-M", "0.01", "--seconds", "6"]
    assert main(["zwidth", "trial", *words, "--out", str(tmp_path / "trial")]) == 0
    capsys.readouterr()
    again = ["--out", str(tmp_path / "again"), "--json"]
    assert main(["zwidth", "import", str(tmp_path / name), *again]) == 0, capsys.readouterr().err
    told = json.loads(capsys.readouterr().out)
    before = json.loads((tmp_path / "trial" / "run.json").read_text())
    assert told["environment"] == before["environment"]
    assert told["simulated"] is True
    assert told["verdict"]["answer"] == before["verdict"]["answer"]


def test_record_of_a_trial_keeps_its_badge_far_from_its_folder(tmp_path, capsys):
    words = [
        "zwidth",
        "trial",
        "-K",
        "30",
        "-B",
        "1",
        "--seconds",
        "8",
        "--out",
        str(tmp_path / "run"),
    ]
    assert main(words) == 0, capsys.readouterr().err
    moved = shutil.copy(tmp_path / "run" / "record.h5", tmp_path / "moved.h5")
    found = read_file(Path(moved))
    assert found.simulated
    assert found.rendered == Environment(30.0, 1.0, 0.0, active_damping_ns_per_m=0.0)
    assert found.max_command_n is not None


def test_counts_are_not_taken_for_newtons(tmp_path):
    np.savez(
        tmp_path / "a.npz", index=range(9), time_ns=range(9), torque=range(9), velocity=range(9)
    )
    with pytest.raises(AnalysisError, match="counts of a recording that was not finished"):
        read_file(tmp_path / "a.npz")


@pytest.mark.parametrize("kind", [".csv", ".npz", ".mat", ".h5"])
def test_file_that_is_not_there_is_named(kind, tmp_path):
    with pytest.raises(ConfigError, match=rf"absent\{kind}: no such file"):
        read_file(tmp_path / f"absent{kind}")


def test_what_is_not_given_is_that_of_the_scene_that_was_named_else_0():
    scene = load_scene("fig4")
    for named in (False, True):
        assert given((None, None, None), None, scene, named) == Environment(
            100.0, 1.0, 0.01, active_damping_ns_per_m=0.0
        )
    assert given((500.0, None, None), None, scene, False) == Environment(
        500.0, 0.0, 0.0, active_damping_ns_per_m=0.0
    )
    assert given((500.0, None, None), None, scene, True) == Environment(
        500.0, 1.0, 0.01, active_damping_ns_per_m=0.0
    )
    assert given((None, 0.0, None), 1.74, scene, False) == Environment(
        0.0, 0.0, 0.0, active_damping_ns_per_m=1.74
    )
    assert given((500.0, None, None), None, None, False) == Environment(
        500.0, 0.0, 0.0, active_damping_ns_per_m=0.0
    )
