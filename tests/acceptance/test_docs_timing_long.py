"""Simulated trials give the stiffness that docs/timing.md and the benchmark say."""

import importlib
from types import ModuleType

import pytest
from support.tree import ROOT

from benchmarks import timing as benchmark
from benchmarks.figures import Figure


@pytest.fixture
def timing(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script, which is no part of the package."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module("timing")


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_trials_of_the_first_row_give_what_the_page_says(timing: ModuleType) -> None:
    (figure,) = benchmark.measure()
    assert isinstance(figure, Figure)
    assert figure.ok
    row = timing.ROWS[0].name
    page = (ROOT / "docs" / "timing.md").read_text()
    (cells,) = [
        line.split(" | ")
        for line in page.splitlines()
        if line.startswith(f"| {row} | ") and "| trials" in line
    ]
    assert figure.reference == pytest.approx(float(cells[3]), rel=0.01)
    assert figure.value == pytest.approx(float(cells[4]), rel=0.01)
