"""Folders of `hapticd zwidth`: what an interruption leaves, one run a folder, what `report`
draws where, Z(f) for others.
"""

from typing import Any

import pytest

from hapticd.cli.app import main
from support.measured_scenes import GRID_OF_27

SHORT = ["--seconds", "20"]
LIMITS = ["limits", *SHORT, "--axis", "BM", "--active-damping", "0", "--no-plot"]
MAP = [
    "map",
    *SHORT,
    "--active-damping",
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
