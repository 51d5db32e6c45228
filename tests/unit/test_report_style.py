"""The family look: ticks that tell values apart, legends that say a thing once, bands and bars
that are what they mean.
"""

from math import e

import numpy as np
import pytest

from hapticd.zwidth.report.style import (
    FINE,
    NOT_JUDGED,
    OFF,
    ON,
    PARTS,
    axes,
    draw_band,
    hertz_axis,
    legend_handles,
    level_styles,
    not_judged,
    plain_axis,
    styled,
    tint,
)

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
    draw_band(axis, X, np.full(3, e), np.ones(3), ON, "a", linear)
    corners = axis.collections[0].get_paths()[0].vertices[:, 1]
    assert (corners.min(), corners.max()) == pytest.approx(expected)


def test_band_is_left_out_where_nothing_is_known(axis):
    draw_band(axis, X, np.ones(3), np.full(3, np.nan), ON)
    assert not any(path.vertices.size for path in axis.collections[0].get_paths())
    assert list(axis.lines[0].get_ydata()) == [1.0, 1.0, 1.0]


def test_legend_names_each_label_once(axis):
    for label in ("a", "b", "a", None):
        axis.plot(X, X, label=label)
    assert [handle.get_label() for handle in legend_handles(axis)] == ["a", "b"]


def test_added_damping_is_blue_and_none_is_dashed():
    for levels, expected in (((0.0, 1.74), (OFF, ON)), ((1.74, 0.0), (ON, OFF)), ((3.5,), (ON,))):
        assert level_styles(levels) == list(expected)
    assert level_styles((0.0, 0.87, 1.74, 3.5))[2] == ON
    colours = [look["color"] for look in level_styles((0.0, 0.87, 1.74, 3.5))]
    assert len(set(colours)) == 4
    assert not set(colours) & {colour for _, colour in PARTS}


def test_tint_is_opaque_and_light():
    assert tint("#000000", 0.5) == "#808080"
    assert tint("#0072B2", 0.0) == "#ffffff"
