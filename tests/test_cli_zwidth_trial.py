"""`hapticd zwidth trial` by multisines, with another window, and as admittance: what is typed, said, kept and drawn."""

import json

import numpy as np
import pytest

from hapticd.cli.app import main

pytest.importorskip("matplotlib")

LINEAR = ["--scene", "theory", "-K", "500", "-B", "1", "-M", "0"]
MULTISINE = ["--excitation", "multisine", "--realisations", "6", "--periods", "1"]


def run(arguments, capsys):
    """(exit code, stdout, stderr)"""
    code = main(["zwidth", *arguments])
    told = capsys.readouterr()
    return code, told.out, told.err


def test_multisine_trial_says_what_its_interval_covers(tmp_path, capsys):
    code, out, _ = run(["trial", *LINEAR, *MULTISINE, "--out", str(tmp_path)], capsys)
    assert code == 0
    assert "passive in band [2, 500] Hz at 95 % confidence" in out
    assert (
        "the interval covers noise and nonlinear distortion at this perturbation, from the scatter of 6 realisations of 1 per"
        in out
    )
    kept = json.loads((tmp_path / "run.json").read_text())
    assert kept["estimator"] == "h_force"
    assert kept["perturbation"]["kind"] == "multisine"
    assert kept["perturbation"]["band_hz"] == 500.0
    assert kept["multisine"]["realisations"] == 6
    assert kept["command_limit_n"] is None


def test_multisine_trial_runs_by_the_whole_stack(tmp_path, capsys):
    words = ["trial", "lockstep", *LINEAR, *MULTISINE, "--realisations", "3", "--out", str(tmp_path), "--json"]
    code, out, _ = run(words, capsys)
    assert code == 0
    found = json.loads(out)
    assert found["multisine"]["realisations"] == 3
    assert found["flown_again"] == 0
    assert 0.0 < found["max_command_n"] < found["command_limit_n"] == 8.0


def test_multisine_of_friction_says_how_many_more(tmp_path, capsys):
    code, out, _ = run(["trial", "--excitation", "multisine", "--out", str(tmp_path)], capsys)
    assert code == 0
    assert "realisations would decide at this confidence; where friction distorts, noise decides sooner" in out


def test_multisines_of_a_file_are_judged_in_their_layout(tmp_path, capsys):
    run(["trial", *LINEAR, *MULTISINE, "--out", str(tmp_path / "made")], capsys)
    made = json.loads((tmp_path / "made" / "run.json").read_text())
    record = str(tmp_path / "made" / "record.h5")
    code, out, _ = run(["trial", record, *MULTISINE, "--out", str(tmp_path / "again"), "--json"], capsys)
    assert code == 0
    found = json.loads(out)
    assert found["multisine"]["realisations"] == 6
    assert found["verdict"]["margin_deg"]["value"] == pytest.approx(made["verdict"]["margin_deg"]["value"], abs=1e-2)


def test_run_of_multisines_is_drawn_again_with_its_admittance(tmp_path, capsys):
    run(["trial", *LINEAR, *MULTISINE, "--out", str(tmp_path), "--admittance"], capsys)
    names = {"trial.png", "trial_admittance.png"}
    drawn = (tmp_path / "trial.svg").read_text()
    assert "predicted" in drawn
    for name in (*names, "trial.svg"):
        (tmp_path / name).unlink()
    assert run(["report", str(tmp_path)], capsys)[0] == 0
    assert names <= {path.name for path in tmp_path.iterdir()}
    assert "predicted" in (tmp_path / "trial.svg").read_text()


def test_longer_window_is_kept_with_the_run(tmp_path, capsys):
    code, _, _ = run(["trial", *LINEAR, "--seconds", "30", "--lag", "4096", "--out", str(tmp_path)], capsys)
    assert code == 0
    assert json.loads((tmp_path / "run.json").read_text())["lag"] == 4096


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--excitation", "chirp"], 2, "--excitation 'chirp': use noise or multisine"),
        (["--excitation", "multisine", "--until-decided"], 2, "multisines are judged at their end; ask for fewer --realisations"),
        (["--excitation", "multisine", "--realisations", "1", "--periods", "1"], 65, "have no scatter to learn from"),
        (["--excitation", "multisine", "--band", "0.5", "500"], 65, "the period of 4096 samples says nothing below 0.977 Hz"),
        (["--lag", "4096", "--seconds", "5"], 65, "a verdict takes 7.68 s or more"),
        (["noise.npz", "--excitation", "multisine"], 65, "a realisation of 1 + 2 periods of 4096 samples takes 3.07 s"),
    ],
)
def test_mistakes_are_answered_in_words(words, code, said, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savez("noise.npz", force_n=np.ones(8000), velocity_m_per_s=np.ones(8000), rate_hz=4000.0)
    found, _, err = run(["trial", *words, "--out", str(tmp_path / "x")], capsys)
    assert found == code
    assert said in " ".join(err.replace("│", " ").split())
