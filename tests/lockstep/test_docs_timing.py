"""The table of docs/timing.md has the numbers that theorem and prediction give, and its laws are
those of the theorem.
"""

import importlib
from types import ModuleType

import numpy as np
import pytest
from support.tree import ROOT

from hapticd.model.theorem import required_damping

PAGE = ROOT / "docs" / "timing.md"


@pytest.fixture
def timing(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script, which is no part of the package."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module("timing")


@pytest.mark.parametrize("place", range(4))
def test_page_has_what_theorem_and_prediction_give(timing: ModuleType, place: int) -> None:
    lines = timing.quick_lines(timing.ROWS[place])
    assert [line[2] for line in lines][-2:] == ["theorem", "prediction"]
    page = PAGE.read_text()
    for line in lines:
        assert f"\n| {' | '.join(line)} |\n" in page


@pytest.mark.parametrize("delay", [0.0, 0.125, 0.25, 0.6875, 1.0])
def test_every_input_asks_a_rigid_display_for_the_closed_form(delay: float) -> None:
    """K = 1,000 N/m, T = 1 ms, at the lowest frequencies; the bound is what noise asks for."""
    needed, hz = required_damping([(1000.0, 0.0, 0.0)], 1000.0, delay)
    closed = 0.5 * (0.5 + delay + np.sqrt(0.25 + 2.0 * delay))
    assert needed[0] == pytest.approx(closed, rel=1e-5)
    assert hz[0] < 1.0
    noise, _ = required_damping([(1000.0, 0.0, 0.0)], 1000.0, delay, baseband=True)
    assert noise[0] == pytest.approx(0.5 + delay, rel=1e-5)


def test_lags_of_the_force_path_enter_the_law(timing: ModuleType) -> None:
    """0.365 N s/m over half a period, the delay, 31.6 Hz of smoothing and an amplifier of 5 kHz."""
    lags_s = 0.75e-3 + 1.0 / (2.0 * np.pi * 31.6) + 1.0 / (2.0 * np.pi * 5000.0)
    assert timing.law(timing.paper_display(0.25), 0.25) == pytest.approx(0.3652 / lags_s, rel=1e-6)
