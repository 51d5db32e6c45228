"""Z(f) for other tools: the same numbers in each format, and an interval that holds."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from support.cli_zwidth_folders import run

from hapticd.zwidth.store import read_summary


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from hapticd.cli.app import main

    folder = tmp_path_factory.mktemp("run")
    assert main(["zwidth", "trial", "--seconds", "20", "--out", str(folder)]) == 0
    return folder


def exported(folder: Path, form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    path = tmp_path / f"z.{form}"
    code, out, _ = run(["export", form, str(folder), str(path), "--json"], capsys)
    assert (code, json.loads(out)["files"]) == (0, [str(path)])
    return path


def test_python_control_gets_a_finite_response_over_the_band(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = np.load(exported(folder, "npz", tmp_path, capsys))
    low_hz, high_hz = read_summary(folder)["verdict"]["band_hz"]
    assert found["response"].dtype == np.complex128
    assert found["response"].shape == found["omega_rad_per_s"].shape
    assert np.isfinite(found["response"]).all()
    assert (np.diff(found["omega_rad_per_s"]) > 0.0).all()
    assert low_hz <= found["frequency_hz"][0]
    assert found["frequency_hz"][-1] <= high_hz
    assert found["passivity_index_ns_per_m"] == found["response"].real.min()


def test_interval_holds_the_value_and_is_the_wider_the_more_is_unexplained(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = np.load(exported(folder, "npz", tmp_path, capsys))
    half = 0.5 * (found["real_high_ns_per_m"] - found["real_low_ns_per_m"])
    assert (half > found["sd_ns_per_m"]).all()
    share = half / np.abs(found["response"])
    order = np.argsort(found["coherence"])
    assert (np.diff(share[order]) <= 1e-12).all()


def test_matlab_gets_it_in_the_shape_of_frd(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    io = pytest.importorskip("scipy.io")
    plain = np.load(exported(folder, "npz", tmp_path, capsys))
    found = io.loadmat(exported(folder, "mat", tmp_path, capsys))
    assert found["response"].shape == (1, 1, plain["response"].size)
    assert found["omega_rad_per_s"].shape == (plain["response"].size, 1)
    assert (found["response"][0, 0] == plain["response"]).all()


def test_table_has_the_same_numbers_with_units_in_its_header(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = np.load(exported(folder, "npz", tmp_path, capsys))
    with exported(folder, "csv", tmp_path, capsys).open(newline="") as file:
        rows = list(csv.DictReader(file))
    real = [float(row["real_ns_per_m"]) for row in rows]
    low = [float(row["real_low_ns_per_m"]) for row in rows]
    assert real == pytest.approx(plain["response"].real, rel=1e-8)
    assert low == pytest.approx(plain["real_low_ns_per_m"], rel=1e-7)


def test_a_file_that_exists_and_a_folder_without_a_trial_are_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = exported(folder, "csv", tmp_path, capsys)
    code, _, err = run(["export", "csv", str(folder), str(path)], capsys)
    assert code == 78
    assert "exists; name another file" in err
    code, _, err = run(["export", "csv", str(tmp_path)], capsys)
    assert code == 78
    assert "run.json" in err
