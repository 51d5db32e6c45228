"""The theorem at all angles: what the nodes say of the sums between them, and of zeros."""

import numpy as np
import pytest
from support.guard_device import rigid
from support.narrow_modes import edge
from test_analysis_rational import LEAF, SHARP, at_angles, springs

from hapticd.model.angles import FIXED
from hapticd.model.bases import model_of
from hapticd.model.coupled import coupled_radius
from hapticd.model.loop import PAPER_FILTERS
from hapticd.model.rational import positive_everywhere, rational
from hapticd.model.theorem import circles, lifted_system, outside_circles

DENSE = np.concatenate((np.geomspace(2e-3, 0.05, 300), np.linspace(0.051, 3.141, 3000)))


def test_a_sharp_filter_that_angles_about_modes_step_over_is_found():
    """Poles of the law count as well: an edge lay 2 % too far by the angles of the device."""
    model = model_of(rigid(0.5))
    found = rational(model, 0.0, SHARP, 0.0)
    lifted = circles(lifted_system(model, 0.0, SHARP))
    dense = at_angles(model, SHARP, DENSE)
    direction = np.array([0.0, 1.0, 0.0])
    true = edge(lambda points: outside_circles(dense, points), direction)
    assert edge(lambda points: outside_circles(lifted, points), direction) > 1.003 * true
    reached = edge(lambda points: positive_everywhere(found, points), direction)
    assert reached == pytest.approx(true, rel=1e-5)


def test_a_mode_that_angles_1_hz_apart_step_over_is_found():
    """Half a promille of critical damping: a spring shakes what the fixed angles call passive."""
    model = LEAF.model()
    point = np.array([[60.0, 0.0, 0.0]])
    assert outside_circles(at_angles(model, PAPER_FILTERS, FIXED), point)[0]
    assert not positive_everywhere(rational(model, 0.0, PAPER_FILTERS, 0.0), point)[0]
    assert coupled_radius(model, point, springs()).max() > 1.0 + 1e-6
