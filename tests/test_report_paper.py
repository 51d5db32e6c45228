"""Figures at the width of a column: type, panels, words, ticks; the same bytes each time."""

import struct
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.text import Text

from hapticd.cli.app import main
from hapticd.errors import ConfigError
from hapticd.report.paper import LEAST_PT, WIDTHS_MM, fit, width_mm
from hapticd.report.style import BELOW, axes, hertz_axis, legend_handles, mosaic, save, styled

LONG = "a label of a line that is longer than half of a column, in words"


@styled()
def drawn() -> Any:
    """Six panels in two rows, wide as a screen, with long words, narrow ticks and a legend."""
    figure, places = axes(
        2, 3, 9.6, 6.0, "A title that goes on, SIMULATED, for K = 100 N/m " * 3, sharey=True
    )
    f = np.geomspace(1.0, 1000.0, 50)
    for at, place in enumerate(places):
        place.plot(f, f * (1 + at), label=f"{LONG} {at % 2}")
        hertz_axis(place, 1.0, 1000.0)
        place.set(title=f"M = {at} g, and what else is to be said of it", ylabel="force (N)")
        place.label_outer()
        place.set_xlabel("frequency (Hz)")
    figure.legend(handles=legend_handles(places[0]) + legend_handles(places[1]), ncols=3, **BELOW)
    return figure


def seen(figure: Any) -> list[Any]:
    """Boxes of all words that are seen, whole figure in pixels."""
    figure.draw_without_rendering()
    renderer = figure._get_renderer()
    words = (one for one in figure.findobj(Text) if one.get_visible() and one.get_text().strip())
    boxes = (one.get_window_extent(renderer) for one in words)
    return [box for box in boxes if box.width > 0.0]


@pytest.fixture(scope="module")
def column() -> Any:
    figure = drawn()
    with styled():
        fit(figure, WIDTHS_MM["column"])
    return figure


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


def test_picture_is_as_wide_as_asked_at_300_dpi(tmp_path: Path) -> None:
    png, _, pdf = save(drawn(), tmp_path, "x", WIDTHS_MM["column"])
    (pixels,) = struct.unpack(">I", png.read_bytes()[16:20])
    assert pixels == 1050  # 3.5 in
    assert b"/MediaBox [ 0 0 252 " in pdf.read_bytes()  # 3.5 in of 72 pt


def test_same_figure_gives_the_same_files(tmp_path: Path) -> None:
    first, second = (save(drawn(), tmp_path / name, "x", 88.9) for name in "ab")
    assert [one.read_bytes() for one in first] == [other.read_bytes() for other in second]


def test_no_type_is_smaller_than_7_pt(column: Any) -> None:
    assert min(one.get_fontsize() for one in column.findobj(Text)) >= LEAST_PT


def test_all_words_are_inside(column: Any) -> None:
    width, height = column.bbox.size
    for box in seen(column):
        assert box.x0 > -1.0
        assert box.y0 > -1.0
        assert box.x1 < width + 1.0
        assert box.y1 < height + 1.0


def test_no_words_lie_on_each_other(column: Any) -> None:
    for one, other in combinations(seen(column), 2):
        assert not one.padded(-1.0).overlaps(other.padded(-1.0))


def test_panels_go_to_the_next_line_in_their_order(column: Any) -> None:
    column.draw_without_rendering()
    places = [axis.get_position() for axis in column.axes]
    lines = sorted({round(place.y0, 2) for place in places}, reverse=True)
    assert [lines.index(round(place.y0, 2)) for place in places] == [0, 0, 1, 1, 2, 2]
    assert all(axis.get_ylabel() == "force (N)" for axis in column.axes[::2])


def test_round_ticks_stay_where_labels_would_touch(column: Any) -> None:
    column.draw_without_rendering()
    shown = [one.get_text() for one in column.axes[4].get_xticklabels() if one.get_text()]
    assert {"1", "10", "100"} <= set(shown)
    assert len(shown) < 10


def test_data_stay_what_they_were(column: Any) -> None:
    for before, after in zip(drawn().axes, column.axes, strict=True):
        assert np.array_equal(before.lines[0].get_xydata(), after.lines[0].get_xydata())
        assert (before.get_xlim(), before.get_ylim()) == (after.get_xlim(), after.get_ylim())


@pytest.fixture(scope="module")
def mixed() -> Any:
    """In a column: a solid beside a plane with a bar of colours; below, words along an axis, and a
    title over axes that long labels make narrow.
    """
    with styled():
        rows = [["solid", "plane"], ["words", "narrow"]]
        solid = {"solid": {"projection": "3d"}}
        figure, panels = mosaic(rows, 6.7, 6.0, "SIMULATED", per_subplot_kw=solid)
        painted = panels["plane"].pcolormesh(np.eye(4))
        figure.colorbar(painted, ax=panels["plane"], label="K (N/m)")
        panels["words"].set_xticks(range(3), ["without\nany", "with\nactive", "damping"])
        panels["narrow"].set(title="damping below the corner", ylabel="a long label " * 6)
        fit(figure, WIDTHS_MM["column"])
        figure.draw_without_rendering()
    return figure, panels


def test_bar_of_colours_stays_at_its_panel(mixed: Any) -> None:
    figure, panels = mixed
    (bar,) = (one.get_position() for one in figure.axes if one.get_label() == "<colorbar>")
    plane, solid = (panels[name].get_position(original=True) for name in ("plane", "solid"))
    assert plane.y1 < solid.y0  # one below the other: beside each other they would be narrow
    assert plane.x1 < bar.x0
    assert (bar.y0, bar.y1) == pytest.approx((plane.y0, plane.y1), abs=1e-6)


def test_no_word_of_an_axis_is_left_out(mixed: Any) -> None:
    _, panels = mixed
    shown = [one.get_text() for one in panels["words"].get_xticklabels()]
    assert shown == ["without\nany", "with\nactive", "damping"]


def test_title_ends_where_its_panel_does(mixed: Any) -> None:
    figure, _ = mixed
    (title,) = (one for one in figure.findobj(Text) if "corner" in one.get_text())
    assert title.get_window_extent(figure._get_renderer()).x1 <= figure.bbox.x1
