"""The verdict as a measurement sees it: through the probe's velocity channel. The rival
device's is AC-coupled at 0.1 Hz.
"""

import numpy as np
from support.analysis_predict_recorded import LEVEL, RIVAL, WHITE, both

from examples.weir2008.run import POINTS, conditions
from hapticd.model.predict import DEFAULT_BAND_HZ, frequencies


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
