"""The verdict as a measurement sees it: through the probe's velocity channel. The rival
device's is AC-coupled at 0.1 Hz.
"""

import numpy as np
from support.analysis_predict_recorded import LEVEL, RIVAL, WHITE, both

from examples.weir2008.paper import MAIN
from examples.weir2008.run import POINTS, conditions
from hapticd.core.units import DEFAULT_BAND_HZ
from hapticd.model.predict import frequencies, predicted_impedance


@LEVEL
def test_recorded_verdict_is_that_of_the_recorded_impedance(level):
    """Re of Z times the channel's turn, one by one, next to the true verdict: the same set on
    the whole grid.
    """
    true, recorded = both(RIVAL, POINTS, level)
    device = conditions(RIVAL).display
    passive = true.passive.copy()
    f = frequencies(DEFAULT_BAND_HZ, WHITE)
    z = device.impedances(POINTS[passive], level, f)
    passive[passive] = (z.real[:, (f >= 2.0) & (f <= 500.0)] >= 0.0).all(axis=1)
    assert np.array_equal(recorded.passive & true.passive, passive)
    assert true.passive.sum() > recorded.passive.sum()
    assert np.array_equal(device.passive(POINTS, level), recorded.passive)


@LEVEL
def test_a_little_too_much_may_look_passive(level):
    """Where Z is mass-like the channel adds X f_h / f: an environment short of it by less
    passes, as it does in trials.
    """
    true, recorded = both(RIVAL, POINTS, level)
    flattered = recorded.passive & ~true.passive
    assert 1 <= flattered.sum() <= 2
    assert -0.004 < true.margin_ns_per_m[flattered][0] < 0.0
    assert recorded.worst_hz[flattered][0] > 100.0


@LEVEL
def test_without_a_high_pass_nothing_is_turned(level):
    """|Z| is larger as recorded, tan x / x for a mass, x = pi f / 4 kHz: 5 % at 500 Hz; no
    verdict changes.
    """
    true, recorded = both(MAIN, POINTS, level)
    assert np.array_equal(true.passive, recorded.passive)
    told = np.abs(true.margin_ns_per_m) > 1e-3  # what the images of the law do is 1e-6 N s/m
    larger = recorded.margin_ns_per_m[told] / true.margin_ns_per_m[told]
    assert larger.min() > 0.999
    assert larger.max() < 1.06


@LEVEL
def test_impedances_of_many_are_those_of_each(level):
    """Friction of each, as if it had been in the device from the start."""
    device = conditions(RIVAL).display
    f = np.geomspace(2.0, 500.0, 60)
    points = POINTS[device.passive(POINTS, level)][::40]
    each = [
        predicted_impedance(device.model, point, f, level, device.filters, device.perturbation)
        for point in points
    ]
    assert np.abs(device.impedances(points, level, f) / each - 1.0).max() < 2e-4
