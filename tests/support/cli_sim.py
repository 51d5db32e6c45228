"""hapticd sim and hapticd accuracy: output, plots, return values and refusals."""

import json
from typing import Any

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


def told(capsys: pytest.CaptureFixture[str], *arguments: str) -> Any:
    code, out, _ = spoken(capsys, *arguments, "--json")
    assert code == 0
    assert out.count("\n") == 1
    return json.loads(out)
