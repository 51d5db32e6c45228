"""Slips on the command line of `hapticd zwidth`: what is wrong is named, the exit code is no crash, nothing is flown."""

import pytest

from hapticd.cli.app import main

TRIAL = ["trial", "--seconds", "8"]
MAP = ["map", "--no-plot", "--seconds", "8", "--damping", "0"]
WALLS = ["walls", "--no-plot", "--damping", "0"]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ([*TRIAL, "--psd", "-1"], 2, "greater than or equal to 0"),
        ([*TRIAL, "--psd", "0"], 65, "perturbation of 0 N^2/Hz"),
        ([*TRIAL, "--psd", "inf"], 65, "perturbation of inf N^2/Hz"),
        ([*TRIAL, "--behind-mass", "inf"], 65, "mass behind the port of inf kg"),
        ([*TRIAL, "--hottest", "nan"], 65, "winding limit of nan degC"),
        ([*TRIAL, "--damping", "inf"], 65, "added damping of inf N s/m"),
        ([*TRIAL, "--viscous", "inf"], 65, "damping of inf N s/m"),
        ([*TRIAL, "-K", "nan"], 65, "stiffness of nan N/m"),
        ([*TRIAL, "--band", "2", "5000"], 65, "say nothing above 2000 Hz"),
        ([*MAP, "--damping", "nan"], 2, "not negative, and finite"),
        ([*MAP, "--damping", "0,inf"], 2, "not negative, and finite"),
        ([*MAP, "--band", "500", "2"], 65, "band of 500..2 Hz"),
        ([*MAP, "--band", "2", "nan"], 65, "band of 2..nan Hz"),
        ([*MAP, "--stiffness", "0", "1000", "-1"], 2, "--stiffness 0 1000 -1"),
        ([*MAP, "--stiffness", "0", "1000", "2000000000"], 2, "--stiffness 0 1000 2000000000"),
        ([*MAP, "--stiffness", "1000", "0", "4"], 2, "--stiffness 1000 0 4"),
        ([*MAP, "--mass", "nan", "0", "4"], 2, "--mass nan 0 4"),
        ([*MAP, "--stiffness", "0", "1", "1000", "--viscous", "0", "1", "1000", "--mass", "0", "1", "11"], 65, "11000000 environ"),
        ([*MAP, "--seconds", "0.2"], 78, "more than the window of 2048"),
        (["limits", "--no-plot", "--damping", "0", "--band", "500", "2"], 65, "band of 500..2 Hz"),
        (["search", "--no-plot", "--damping", "0", "--band", "500", "2"], 65, "band of 500..2 Hz"),
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
