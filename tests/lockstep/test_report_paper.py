"""Figures at the width of a column: type, panels, words, ticks; the same bytes each time."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.text import Text

from hapticd.cli.app import main
from hapticd.core.errors import ConfigError
from hapticd.zwidth.report.paper import WIDTHS_MM, settle, width_mm
from hapticd.zwidth.report.style import mosaic, styled


def test_widths_have_names_and_are_millimetres() -> None:
    assert [width_mm(text) for text in ("column", "text", "120")] == [88.9, 181.0, 120.0]


@pytest.mark.parametrize("text", ["0", "-90", "nan", "inf", "59", "401", "wide", ""])
def test_nonsense_width_is_refused_with_value_unit_limits_and_remedy(text: str) -> None:
    with pytest.raises(ConfigError, match=r"60 to 400 mm are possible.*write column \(88.9 mm\)"):
        width_mm(text)


def test_command_line_refuses_before_it_works(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["zwidth", "trial", "--figure-width", "5000", "--out", str(tmp_path / "new")]
    assert main(words) == 2
    assert "60 to 400 mm" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "new").exists()


@pytest.fixture(scope="module")
def mixed() -> Any:
    """In a column: a solid beside a plane with a bar of colours; below, words along an axis, and a
    title over axes that long labels make narrow.
    """
    with styled():
        rows = [["solid", "plane"], ["words", "narrow"]]
        solid = {"solid": {"projection": "3d"}}
        asked = (6.7, 6.0, "SIMULATED", WIDTHS_MM["column"], 2.2)
        figure, panels = mosaic(rows, *asked, per_subplot_kw=solid)
        painted = panels["plane"].pcolormesh(np.eye(4))
        figure.colorbar(painted, ax=panels["plane"], label="K (N/m)")
        panels["words"].set_xticks(range(3), ["without\nany", "with\nactive", "damping"])
        panels["narrow"].set(title="damping below the corner", ylabel="a long label " * 6)
        settle(figure)
    return figure, panels


def test_no_word_of_an_axis_is_left_out(mixed: Any) -> None:
    _, panels = mixed
    shown = [one.get_text() for one in panels["words"].get_xticklabels()]
    assert shown == ["without\nany", "with\nactive", "damping"]


def test_title_ends_where_its_panel_does(mixed: Any) -> None:
    figure, _ = mixed
    (title,) = (one for one in figure.findobj(Text) if "corner" in one.get_text())
    assert title.get_window_extent(figure._get_renderer()).x1 <= figure.bbox.x1
