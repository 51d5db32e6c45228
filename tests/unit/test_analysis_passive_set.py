"""The passive set: its limits, its volume, and what a grid must be."""

import re

import numpy as np
import pytest
from support.analysis_devices import display

from hapticd.core.errors import AnalysisError
from hapticd.model.linearise import Perturbation
from hapticd.model.predict import predict
from hapticd.zwidth.passive_set import PassiveSet, axis_limit, grid

AXES = (np.linspace(0, 1000, 21), np.linspace(-2, 6, 17), np.linspace(-0.02, 0.02, 9))


def wedge(points):
    """Passive where K/1000 + |B - 1|/3 + |M|/0.01 <= 0.8."""
    k, b, m = points.T
    return 0.8 - k / 1000 - np.abs(b - 1.0) / 3 - np.abs(m) / 0.01


SET = PassiveSet.of(AXES, wedge(grid(AXES)))


def test_set_limits_are_extremes_over_all():
    found = SET.limits()
    assert found.stiffness == (0.0, 800.0)
    assert found.virtual_damping == (-1.0, 3.0)
    assert found.mass == pytest.approx((-0.005, 0.005))


def test_open_ends_are_where_the_grid_cuts_the_set():
    k, b, m = AXES
    for axes, ends in (
        (AXES, ()),
        ((k[2:], b, m), ("K min",)),
        ((k[:10], b, m), ("K max",)),
        ((k, b[4:], m[:5]), ("B min", "M max")),
    ):
        assert PassiveSet.of(axes, wedge(grid(axes))).open_ends() == ends


def test_axis_limits_differ_from_set_limits():
    """At B = 0 and not at B = 1 the axis sees less stiffness: the two readings of one headline."""
    assert axis_limit(lambda points: wedge(points) >= 0, 0, 2000.0) == pytest.approx(
        1000 * (0.8 - 1 / 3), abs=0.1
    )
    assert axis_limit(lambda points: wedge(points) >= 0, 2, -0.05) == pytest.approx(
        -0.01 * (0.8 - 1 / 3), abs=1e-5
    )
    assert SET.limits().stiffness[1] == 800.0


def test_axis_limit_at_its_ends():
    assert axis_limit(lambda points: np.ones(len(points), bool), 1, 5.0) == 5.0
    assert np.isnan(axis_limit(lambda points: np.zeros(len(points), bool), 1, 5.0))
    assert axis_limit(
        lambda points: points[:, 1] < 2.0, 1, 5.0, base=(7.0, 1.0, 0.0)
    ) == pytest.approx(2.0, abs=1e-4)


def test_volume_of_a_pyramid():
    """Half an octahedron with K up to 800, B within 2.4 and M within 8 g of the middle: 800 x
    4.8 x 0.016 / 6.
    """
    axes = (np.linspace(0, 1000, 41), np.linspace(-2, 6, 41), np.linspace(-0.02, 0.02, 41))
    assert PassiveSet.of(axes, wedge(grid(axes))).volume() == pytest.approx(
        800 * 4.8 * 0.016 / 6, rel=0.03
    )


def test_volume_counts_shares_of_cells():
    axes = (np.array([0.0, 1.0]),) * 3
    half = PassiveSet.of(axes, 0.5 - grid(axes)[:, 0])
    assert half.volume() == pytest.approx(0.5)
    assert PassiveSet.of(axes, np.full(8, np.nan)).volume() == 0.0


@pytest.mark.parametrize(
    ("axes", "margin", "message"),
    [
        (
            ([0.0, 1.0], [0.0, 1.0], [0.0, 1.0]),
            np.zeros(7),
            "7 margins for a grid of 2 x 2 x 2 environments",
        ),
        (
            ([0.0], [0.0, 1.0], [0.0, 1.0]),
            np.zeros(4),
            "at least two ascending values on each of its three axes",
        ),
        (([1.0, 0.0], [0.0, 1.0], [0.0, 1.0]), np.zeros(8), "at least two ascending values"),
    ],
)
def test_grid_that_is_none_is_refused(axes, margin, message):
    with pytest.raises(AnalysisError, match=re.escape(message)):
        PassiveSet.of(axes, margin)


def test_empty_set_has_no_limits():
    with pytest.raises(AnalysisError, match="no environment of the grid is passive"):
        PassiveSet.of(AXES, -np.ones(SET.margin.size)).limits()


def test_prediction_fills_a_set():
    axes = (np.linspace(0, 200, 9), np.linspace(-1, 4, 6), np.linspace(-0.01, 0.01, 5))
    found = predict(display(), grid(axes), perturbation=Perturbation())
    filled = PassiveSet.of(axes, found.decided_margin)
    assert np.array_equal(filled.passive.ravel(), found.passive)
