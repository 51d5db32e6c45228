"""Folders of `hapticd zwidth`: the files after an interruption, one run per folder, the plots of
`report`, and the export of Z(f).
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
