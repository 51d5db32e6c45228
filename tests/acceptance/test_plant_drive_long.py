"""The impact of `support.impact` from the longest to the shortest step that the engine has."""

import pytest
from support.impact import SPEEDS, impact, stays_bounded


@pytest.mark.timeout(600)  # the kernel of 64 sub-steps is compiled for many seconds
@pytest.mark.parametrize(
    ("substeps", "rate_hz", "dtype"),
    [(1, 1000.0, "f32"), (16, 4000.0, "f32"), (16, 4000.0, "f64"), (64, 4000.0, "f64")],
)
def test_impact_at_full_active_damping_stays_bounded_at_every_step(substeps, rate_hz, dtype):
    for speed in SPEEDS:
        stays_bounded(impact(speed, substeps, dtype, rate_hz), speed)
