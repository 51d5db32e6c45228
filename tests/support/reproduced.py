"""The paper by prediction, once for all tests."""

from functools import cache

import pytest

from examples.weir2008 import future_work
from examples.weir2008.future_work import FutureWorkResult, plan_future_work, run_future_work
from examples.weir2008.run import ReproduceResult, plan_reproduce, run_reproduce


@cache
def by_prediction() -> ReproduceResult:
    """A run of `reproduce --quick`."""
    return run_reproduce(plan_reproduce(quick=True))


@cache
def future_work_by_prediction() -> FutureWorkResult:
    """Return the future work beyond the paper, with fewer corners and levels."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(future_work, "HIGHPASS_HZ", (2.0, 10.0, 50.0))
        patch.setattr(future_work, "LOWPASS_HZ", (20.0, 200.0))
        patch.setattr(future_work, "DAMPING_LEVELS", (0.0, 0.87, 1.74, 3.48, 8.0))
        return run_future_work(plan_future_work(quick=True))
