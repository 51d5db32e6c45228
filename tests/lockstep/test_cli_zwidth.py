"""`hapticd zwidth`: what a person types, gets printed, and finds in the run folder; slips are
named and nothing is started.
"""

import json
import re

import pytest
from support.cli_zwidth import SHORT, run

from hapticd.cli.app import main


def test_trial_in_json_is_one_object(tmp_path, capsys):
    code, out, _ = run(["trial", *SHORT, "--out", str(tmp_path), "--json", "--seed", "5"], capsys)
    found = json.loads(out)
    assert code == 0
    assert found["ok"] is True
    assert found["seed"] == 5
    assert found["verdict"]["answer"] in ("passive", "undecided")


def test_undecided_trial_says_what_would_decide(tmp_path, capsys):
    _, out, _ = run(["trial", "--seconds", "6", "--out", str(tmp_path)], capsys)
    assert "undecided in band" in out
    assert re.search(r"^a record like it of some \d{1,2}0? s would decide$", out, re.MULTILINE)


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["trial", "--estimator", "h"], 2, "'h' is not one of 'spa', 'h_force'"),
        (["trial", "x.csv", "--stepped-sine"], 2, "a record that exists cannot be perturbed again"),
        (["trial", "--seconds", "1"], 65, "a trial of 1 s: a verdict takes 3.84 s or more"),
        (["trial", "--scene", "fgi4"], 78, "did you mean 'fig4'?"),
        (["trial", "nothing.csv"], 2, "no such file"),
        (["trial", "--band", "1", "500", "--seconds", "8"], 65, "band from 1 Hz"),
        (["limits", "--axis", "X"], 2, "use one or more of the letters K, B, M"),
        (["limits", "--active-damping", "on"], 2, "numbers in N s/m"),
        (["limits", "--active-damping", "-1"], 2, "levels must be finite and not negative"),
        (
            ["map", "--executor", "ray"],
            78,
            "executor 'ray': use auto, thread, process or dask://HOST:PORT",
        ),
        (
            ["limits", "--executor", "dask://here"],
            78,
            "executor 'dask://here': use auto, thread, process or dask://HOST:PORT",
        ),
        (
            ["search", "--executor", "dask:8786"],
            78,
            "executor 'dask:8786': use auto, thread, process or dask://HOST:PORT",
        ),
        (["walls", "--scene", "fig4"], 65, "it has no wall to hit"),
    ],
)
def test_mistakes_are_answered_in_words(words, code, said, tmp_path, capsys):
    found, _, err = run([*words, "--out", str(tmp_path / "x")], capsys)
    assert found == code
    assert said in " ".join(err.replace("│", " ").split())


TRIAL = ["trial", "--seconds", "8"]
MAP = ["map", "--no-plot", "--seconds", "8", "--active-damping", "0"]
WALLS = ["walls", "--no-plot", "--active-damping", "0"]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ([*TRIAL, "--psd", "-1"], 2, "not in the range x>=0"),
        ([*TRIAL, "--psd", "0"], 65, "perturbation of 0 N^2/Hz"),
        ([*TRIAL, "--psd", "inf"], 65, "perturbation of inf N^2/Hz"),
        ([*TRIAL, "--behind-mass", "inf"], 65, "mass behind the port of inf kg"),
        ([*TRIAL, "--hottest", "nan"], 65, "winding limit of nan degC"),
        ([*TRIAL, "--active-damping", "inf"], 65, "active damping of inf N s/m"),
        ([*TRIAL, "--viscous", "inf"], 65, "damping of inf N s/m"),
        ([*TRIAL, "-K", "nan"], 65, "stiffness of nan N/m"),
        ([*TRIAL, "--band", "2", "5000"], 65, "contain nothing above 2000 Hz"),
        ([*MAP, "--active-damping", "nan"], 2, "levels must be finite and not negative"),
        ([*MAP, "--active-damping", "0,inf"], 2, "levels must be finite and not negative"),
        ([*MAP, "--band", "500", "2"], 65, "band of 500..2 Hz"),
        ([*MAP, "--band", "2", "nan"], 65, "band of 2..nan Hz"),
        ([*MAP, "--stiffness", "0", "1000", "-1"], 2, "--stiffness 0 1000 -1"),
        ([*MAP, "--stiffness", "0", "1000", "2000000000"], 2, "--stiffness 0 1000 2000000000"),
        ([*MAP, "--stiffness", "1000", "0", "4"], 2, "--stiffness 1000 0 4"),
        ([*MAP, "--mass", "nan", "0", "4"], 2, "--mass nan 0 4"),
        (
            [
                *MAP,
                "--stiffness",
                "0",
                "1",
                "1000",
                "--viscous",
                "0",
                "1",
                "1000",
                "--mass",
                "0",
                "1",
                "11",
            ],
            65,
            "11000000 environ",
        ),
        ([*MAP, "--seconds", "0.2"], 78, "more than the window of 2048"),
        (
            ["limits", "--no-plot", "--active-damping", "0", "--band", "500", "2"],
            65,
            "band of 500..2 Hz",
        ),
        (
            ["search", "--no-plot", "--active-damping", "0", "--band", "500", "2"],
            65,
            "band of 500..2 Hz",
        ),
        ([*WALLS, "--stiffness", "0", "100", "3"], 65, "above 0 N/m"),
        ([*WALLS, "--stiffness", "10", "nan", "3"], 2, "--stiffness 10 nan 3"),
        ([*WALLS, "--viscous", "0", "1", "0"], 2, "--viscous 0 1 0"),
        ([*WALLS, "--settle-s", "nan"], 65, "to settle nan s"),
        ([*WALLS, "--settle-s", "-1"], 65, "to settle -1 s"),
        ([*WALLS, "--still", "nan"], 65, "rest at nan m/s"),
    ],
)
def test_slip_is_named(words, code, said, tmp_path, capsys):
    found = main(["zwidth", *words, "--out", str(tmp_path / "x")])
    told = capsys.readouterr()
    assert said in " ".join(told.err.replace("│", " ").split())
    assert found == code
    assert not (tmp_path / "x").exists()
