"""Figures at the width of a column: type, panels, words, ticks; the same bytes each time."""

import struct
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.text import Text
from support.report_paper import drawn

from hapticd.zwidth.report.paper import LEAST_PT, WIDTHS_MM, settle
from hapticd.zwidth.report.style import mosaic, save, styled


def beyond_view(figure: Any) -> set[Any]:
    """Labels of ticks beyond the ends of their axes, which matplotlib keeps and does not draw."""
    found = set()
    for each in (one for axis in figure.axes for one in (axis.xaxis, axis.yaxis)):
        low, high = sorted(each.get_view_interval())
        found |= {
            tick.label1 for tick in each.get_major_ticks() if not low <= tick.get_loc() <= high
        }
    return found


def seen(figure: Any) -> list[Any]:
    """Boxes of all words that are seen, whole figure in pixels."""
    figure.draw_without_rendering()
    renderer = figure._get_renderer()
    beyond = beyond_view(figure)
    words = (
        one
        for one in figure.findobj(Text)
        if one.get_visible() and one.get_text().strip() and one not in beyond
    )
    boxes = (one.get_window_extent(renderer) for one in words)
    return [box for box in boxes if box.width > 0.0]


@pytest.fixture(scope="module")
def column() -> Any:
    figure = drawn(WIDTHS_MM["column"])
    with styled():
        settle(figure)
    return figure


def test_same_figure_gives_the_same_files(tmp_path: Path) -> None:
    first, second = (save(drawn(88.9), tmp_path / name, "x") for name in "ab")
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


def test_picture_is_as_wide_as_asked_at_300_dpi(tmp_path: Path) -> None:
    png, _, pdf = save(drawn(WIDTHS_MM["column"]), tmp_path, "x")
    (pixels,) = struct.unpack(">I", png.read_bytes()[16:20])
    assert pixels == 1050  # 3.5 in
    assert b"/MediaBox [ 0 0 252 " in pdf.read_bytes()  # 3.5 in of 72 pt


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


def test_bar_of_colours_stays_at_its_panel(mixed: Any) -> None:
    figure, panels = mixed
    (bar,) = (one.get_position() for one in figure.axes if one.get_label() == "<colorbar>")
    plane, solid = (panels[name].get_position(original=True) for name in ("plane", "solid"))
    assert plane.y1 < solid.y0  # one below the other: beside each other they would be narrow
    assert plane.x1 < bar.x0
    assert (bar.y0, bar.y1) == pytest.approx((plane.y0, plane.y1), abs=1e-6)
