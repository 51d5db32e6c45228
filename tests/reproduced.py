"""The paper by prediction, once for all tests."""

from functools import cache

from hapticd.measure.reproduce import ReproduceParams, ReproduceResult, plan_reproduce, run_reproduce


@cache
def by_prediction() -> ReproduceResult:
    """A run of `reproduce --quick`."""
    return run_reproduce(plan_reproduce(ReproduceParams(quick=True)))
