"""`hapticd zwidth trial` by multisines, with another window, and as admittance: what is typed, said, kept and drawn."""

import json
import re

import numpy as np
import pytest
from typer.main import get_command

from hapticd.cli.app import app, main

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


def test_multisine_of_friction_names_no_number_that_means_nothing(tmp_path, capsys):
    """Thousands of realisations, told from eight of them."""
    code, out, _ = run(["trial", "--excitation", "multisine", "--out", str(tmp_path)], capsys)
    assert code == 0
    assert "many more than 8 realisations would be needed; use noise (--excitation noise)" in out


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


@pytest.mark.parametrize("electrical", ["--damping", "--added-damping"])
@pytest.mark.parametrize("virtual", ["-B", "--viscous"])
def test_damping_is_electrical_and_viscous_is_virtual(virtual, electrical, tmp_path, capsys):
    """As in `map` and in `hapticd damping`; the second name is a former one."""
    record = np.random.default_rng(1).normal(0.0, 0.2, (2, 40_000))
    np.savez(tmp_path / "a.npz", force=record[0], velocity=record[1], fs=4000.0)
    for words in (["trial", "--seconds", "8", "-K", "0", "-M", "0"], ["import", str(tmp_path / "a.npz")]):
        code, out, _ = run([*words, virtual, "3", electrical, "1.74", "--out", str(tmp_path / words[0])], capsys)
        assert code == 0
        assert "K 0 N/m, B 3 N s/m, M 0 kg, added damping 1.74 N s/m\n" in out


@pytest.mark.parametrize("verb", ["trial", "import", "limits", "map", "search", "walls", "report"])
def test_help_has_one_name_for_each_damping(verb, capsys):
    told = " ".join(run([verb, "--help"], capsys)[1].split())
    assert "--damping" in told
    assert "--added-damping" not in told


def bracketed(command, path=()):
    """Every text in square brackets in the help of a verb, with the words that call it."""
    for name, below in getattr(command, "commands", {}).items():
        yield from bracketed(below, (*path, name))
    texts = [command.help, *(getattr(param, "help", "") for param in command.params)]
    yield from ((path, found) for text in texts for found in re.findall(r"\[[^\]]*\]", text or ""))


def test_brackets_of_help_texts_are_printed(capsys):
    """Unless escaped they are taken for markup."""
    for path, text in bracketed(get_command(app)):
        main([*path, "--help"])
        assert text in capsys.readouterr().out, f"{' '.join(path)}: {text}"


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
