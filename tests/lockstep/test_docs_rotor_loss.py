"""What docs/rotor_loss.py adds to a device is the loss that its page names, and its table has a
place.
"""

import importlib
from types import ModuleType

import numpy as np
import pytest
from support.tree import ROOT

from examples.weir2008.paper import MAIN
from examples.weir2008.run import conditions
from hapticd.model.predict import predicted_impedance

PAGE = ROOT / "docs" / "reproduction.md"
FREE = (0.0, 0.0, 0.0)


@pytest.fixture
def loss(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script, which is no part of the package."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module("rotor_loss")


@pytest.fixture
def markdown(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module("pages.markdown")


@pytest.mark.parametrize("level", [0.0, 1.74])
def test_loss_is_h_over_omega_with_the_stiffness_that_causality_asks_for(
    loss: ModuleType, level: float
) -> None:
    f = np.geomspace(1.0, 1000.0, 31)
    omega = 2.0 * np.pi * f
    model = conditions(MAIN).display.model
    lossy = loss.with_loss(model, 15.0, (0.1, 1e4))
    with_it, without = (
        predicted_impedance(one, FREE, f, level, recorded=False) for one in (lossy, model)
    )
    added = (with_it - without) * omega
    assert np.allclose(added.real, 15.0, rtol=0.04)
    half_a_step = 0.5 * np.log(10.0) / loss.PER_DECADE
    stiffness = 2.0 / np.pi * 15.0 * (np.log(f / 0.1) + half_a_step)
    assert np.allclose(-added.imag, stiffness, atol=0.5)


def test_elements_hold_nothing_in_place(loss: ModuleType) -> None:
    model = loss.with_loss(conditions(MAIN).display.model, 15.0, (1.0, 1e3))
    assert not (model.a() @ model.translation()).any()


def test_table_written_again_is_the_same_page(markdown: ModuleType) -> None:
    page = PAGE.read_text()
    for name in ("loss", "travel", "held"):
        part = page.partition(f"<!-- {name} -->\n")[2].partition(f"<!-- end of {name} -->")[0]
        assert part.count("\n| ") >= 5
        assert markdown.replaced(page, name, part) == page


def test_page_without_a_place_is_refused(markdown: ModuleType) -> None:
    with pytest.raises(ValueError, match="no place for 'loss'"):
        markdown.replaced("<!-- loss -->\n", "loss", "")
