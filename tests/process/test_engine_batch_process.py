"""A batch: the same bytes however it is spread, records that agree with sums, divergence with
its time, refusals.
"""

from concurrent.futures import ProcessPoolExecutor

import pytest
from support.engine_batch import PARAMS, WEIR, same_bytes

from hapticd.zwidth.engine.batch import simulate


@pytest.fixture(scope="module")
def reference():
    return simulate(WEIR, PARAMS, 0.5, 7, active_damping=1.74, keep="records")


@pytest.mark.process
def test_process_pool_gives_the_same_bytes(reference):
    with ProcessPoolExecutor(1) as pool:
        assert same_bytes(
            reference,
            simulate(WEIR, PARAMS, 0.5, 7, active_damping=1.74, keep="records", executor=pool),
        )
