"""The impact of `support.impact` at every length of step that the engine has."""

import pytest
from support.impact import SPEEDS, impact, stays_bounded


@pytest.mark.parametrize("dtype", ["f32", "f64"])
@pytest.mark.parametrize(("substeps", "rate_hz"), [(1, 1000.0), (16, 4000.0), (64, 4000.0)])
def test_impact_at_full_active_damping_stays_bounded_at_every_step(substeps, rate_hz, dtype):
    for speed in SPEEDS:
        stays_bounded(impact(speed, substeps, dtype, rate_hz), speed)
