"""The family look: ticks that tell values apart, legends that say a thing once, bands and bars
that are what they mean.
"""

from math import e

import numpy as np
import pytest

from hapticd.report.passive_set import area, draw_guess, walls_figure
from hapticd.report.style import (
    FINE,
    NOT_JUDGED,
    ON,
    axes,
    banded,
    handles_of,
    hertz_axis,
    not_judged,
    plain_axis,
    styled,
)
from hapticd.settings.scene import load_scene
from hapticd.zwidth.walls import WallLine, WallParams, WallResult, plan_walls

pytest.importorskip("matplotlib")

X = np.array([1.0, 2.0, 3.0])


@pytest.fixture
def axis():
    """One of an empty figure."""
    with styled():
        _, (only,) = axes(1, 1, 4.0, 3.0)
        yield only


def ticks(axis):
    """Words at an axis, by their value, those in view."""
    low, high = axis.get_view_interval()
    words = axis.get_major_formatter().format_ticks(axis.get_majorticklocs())
    return {
        place: word
        for place, word in zip(axis.get_majorticklocs(), words, strict=True)
        if low <= place <= high
    }


# --- axes -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("spread", [1.0, 1.0001, 1.02, 1.3, 5.0, 400.0])
def test_logarithmic_ticks_are_round_and_unlike_however_short_the_axis(axis, spread):
    axis.plot(X, 2.0 * np.array([1.0, spread**0.5, spread]))
    axis.set_yscale("log")
    plain_axis(axis.yaxis, FINE)
    found = ticks(axis.yaxis)
    assert len(found) >= 3
    assert len(set(found.values())) == len(found)
    assert all(float(word) == pytest.approx(place) for place, word in found.items())


def test_frequencies_are_told_at_one_two_and_five(axis):
    hertz_axis(axis, 2.0, 1000.0)
    assert list(ticks(axis.xaxis).values()) == [
        "2",
        "5",
        "10",
        "20",
        "50",
        "100",
        "200",
        "500",
        "1000",
    ]
    assert axis.get_xlabel() == "frequency (Hz)"


def test_grey_covers_what_is_not_judged_and_keeps_the_range(axis):
    hertz_axis(axis, 2.0, 1000.0)
    handle = not_judged([axis], (3.0, 500.0))
    spans = sorted((span.get_x(), span.get_x() + span.get_width()) for span in axis.patches)
    assert spans[0][0] < 2.0
    assert (spans[0][1], spans[1][0]) == (3.0, 500.0)
    assert spans[1][1] > 1000.0
    assert axis.get_xlim() == (2.0, 1000.0)
    assert handle.get_label() == "not judged"
    assert handle.get_facecolor() == axis.patches[0].get_facecolor()
    assert NOT_JUDGED == "#e9e9e9"


# --- lines and marks ------------------------------------------------------------------------------


@pytest.mark.parametrize(("linear", "expected"), [(False, (1.0, e**2)), (True, (e - 1.0, e + 1.0))])
def test_band_is_the_interval_of_the_logarithm_or_of_the_value(axis, linear, expected):
    banded(axis, X, np.full(3, e), np.ones(3), ON, "a", linear)
    corners = axis.collections[0].get_paths()[0].vertices[:, 1]
    assert (corners.min(), corners.max()) == pytest.approx(expected)


def test_band_is_left_out_where_nothing_is_known(axis):
    banded(axis, X, np.ones(3), np.full(3, np.nan), ON)
    assert not any(path.vertices.size for path in axis.collections[0].get_paths())
    assert list(axis.lines[0].get_ydata()) == [1.0, 1.0, 1.0]


def test_legend_names_each_label_once(axis):
    for label in ("a", "b", "a", None):
        axis.plot(X, X, label=label)
    assert [handle.get_label() for handle in handles_of(axis)] == ["a", "b"]


def test_guess_is_the_mark_of_its_trials_hollow(axis):
    draw_guess(axis, X, X, {"color": ON["color"], "marker": "s"})
    assert axis.lines[0].get_markerfacecolor() == "none"
    assert (axis.lines[0].get_marker(), axis.lines[0].get_markeredgecolor()) == ("s", ON["color"])


def test_smaller_set_lies_on_top(axis):
    for rank, top in enumerate((1.0, 5.0)):
        area(axis, X, np.full(3, top), ON, rank)
    small, large = (painted.get_zorder() for painted in axis.collections)
    assert small > large


# --- walls ----------------------------------------------------------------------------------------


def walls(highest):
    """One level: the stiffest stable wall at each of three dampings."""
    plan = plan_walls(WallParams(load_scene("wall"), (20.0, 40.0), (0.0, 1.0, 2.0), (1.74,)))
    lines = (
        WallLine(1.74, damping, stiffness, False, ())
        for damping, stiffness in zip((0.0, 1.0, 2.0), highest, strict=True)
    )
    return walls_figure(WallResult(plan, tuple(lines)))


def test_walls_fill_their_figure_whether_or_not_all_rest():
    """A line without points that is not clipped lies in the corner of a figure, and axes would
    make room for it.
    """
    figures = [walls(highest) for highest in ((900.0, 950.0, 800.0), (900.0, 950.0, 0.0))]
    for figure in figures:
        figure.draw_without_rendering()
    every, some = (figure.axes[0].get_position() for figure in figures)
    assert every.bounds == pytest.approx(some.bounds, abs=0.02)
    assert every.height > 0.55
