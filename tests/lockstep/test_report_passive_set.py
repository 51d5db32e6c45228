"""Figures of the passive set: slices, the smaller set on top, hollow predictions, walls."""

import numpy as np
import pytest

from hapticd.settings.scene import load_scene
from hapticd.zwidth.map import LevelMap, MapResult
from hapticd.zwidth.passive_set import PassiveSet
from hapticd.zwidth.report.passive_set import (
    area,
    draw_predicted,
    slice_masses,
    slices,
    walls_figure,
)
from hapticd.zwidth.report.style import ON, axes, styled
from hapticd.zwidth.walls import WallLine, WallMapParams, WallResult, plan_walls

pytest.importorskip("matplotlib")


def test_slices_of_a_map_hold_the_mass_nearest_to_zero():
    for masses in (
        np.linspace(-0.03, 0.02, 11),
        np.linspace(-0.002, 0.06, 32),
        np.array([-0.03, -0.01]),
    ):
        margin = np.ones((2, 3, masses.size))
        found = PassiveSet((np.array([0.0, 1.0]), np.arange(3.0), masses), margin)
        shown = slices(
            MapResult(None, (LevelMap(0.0, found, np.zeros(margin.size, bool), (), None, 0),), 0)
        )
        assert int(np.argmin(np.abs(masses))) in shown
        assert len(shown) in (2, 3, 6)
        assert (np.diff(shown) > 0).all()


def test_slices_of_a_search_go_through_its_trials():
    tried = np.array([-0.009, 0.001, 0.0011, 0.0012, 0.004])
    assert slice_masses(tried, np.array([-0.01, -0.005, 0.0, 0.005]), 0.0005) == pytest.approx(
        [-0.009, -0.0025, 0.001]
    )


X = np.array([1.0, 2.0, 3.0])


@pytest.fixture
def axis():
    """One of an empty figure."""
    with styled():
        _, (only,) = axes(1, 1, 4.0, 3.0)
        yield only


def test_guess_is_the_mark_of_its_trials_hollow(axis):
    draw_predicted(axis, X, X, {"color": ON["color"], "marker": "s"})
    assert axis.lines[0].get_markerfacecolor() == "none"
    assert (axis.lines[0].get_marker(), axis.lines[0].get_markeredgecolor()) == ("s", ON["color"])


def test_smaller_set_lies_on_top(axis):
    for rank, top in enumerate((1.0, 5.0)):
        area(axis, X, np.full(3, top), ON, rank)
    small, large = (painted.get_zorder() for painted in axis.collections)
    assert small > large


def walls(highest):
    """One level: the stiffest stable wall at each of three dampings."""
    plan = plan_walls(WallMapParams(load_scene("wall"), (20.0, 40.0), (0.0, 1.0, 2.0), (1.74,)))
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
