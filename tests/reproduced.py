"""The paper by prediction, once for all tests."""

from functools import cache

import pytest

from hapticd.measure import beyond
from hapticd.measure.beyond import BeyondResult, plan_beyond, run_beyond
from hapticd.measure.reproduce import ReproduceResult, plan_reproduce, run_reproduce


@cache
def by_prediction() -> ReproduceResult:
    """A run of `reproduce --quick`."""
    return run_reproduce(plan_reproduce(quick=True))


@cache
def beyond_by_prediction() -> BeyondResult:
    """What goes beyond the paper, with fewer corners and levels."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(beyond, "HIGHPASS_HZ", (2.0, 10.0, 50.0))
        patch.setattr(beyond, "LOWPASS_HZ", (20.0, 200.0))
        patch.setattr(beyond, "DAMPING_LEVELS", (0.0, 0.87, 1.74, 3.48, 8.0))
        return run_beyond(plan_beyond(quick=True))
