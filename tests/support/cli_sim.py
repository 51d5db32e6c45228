"""hapticd sim and hapticd accuracy: what they print, draw, return and refuse."""

import pytest

from hapticd.cli.app import main

MINE = """
title = "mine"
device = "ideal"
effects = ["probe", "viscous"]
seconds = 8.0
[environment]
stiffness_n_per_m = 100.0
virtual_damping_ns_per_m = 0.5
mass_kg = 0.0
[excitation]
kind = "noise"
"""


def spoken(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = main(arguments)
    captured = capsys.readouterr()
    return code, captured.out, captured.err
