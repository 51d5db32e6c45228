"""Stage histograms against numpy's percentiles of the same numbers."""

import numpy as np
import pytest

from hapticd.gateway.histogram import EDGES_NS, PER_DECADE, StageHistograms
from hapticd.gateway.records import DTYPE
from hapticd.mailbox.layout import STAGES

BIN = 10 ** (1 / PER_DECADE)


def records(times_ns: np.ndarray, start_ns: int = 0) -> np.ndarray:
    found = np.zeros(len(times_ns), DTYPE)
    found["time_ns"] = start_ns + 1_000_000 * np.arange(len(times_ns))
    for place, stage in enumerate(STAGES):
        found[f"{stage}_ns"] = times_ns * (place + 1)
    return found


def test_percentiles_are_exact_to_one_bin() -> None:
    times_ns = np.random.default_rng(1).lognormal(9.0, 1.0, 50_000).astype(np.int32)
    histograms = StageHistograms(grace_s=0.0)
    for part in np.array_split(times_ns, 70):
        histograms.add(records(part), 0)
    for place, stage in enumerate(STAGES):
        found = histograms.summary()[stage]
        for name, share in (("p50_us", 50), ("p99_us", 99), ("p999_us", 99.9)):
            exact_us = np.percentile(times_ns, share) * (place + 1) / 1000
            assert exact_us / 1.001 <= found[name] <= exact_us * BIN * 1.001
        assert found["max_us"] == times_ns.max() * (place + 1) / 1000
        assert found["count"] == len(times_ns)


def test_grace_is_left_out() -> None:
    histograms = StageHistograms(grace_s=0.5)
    histograms.add(records(np.full(1000, 100), start_ns=7), 7)
    assert histograms.summary()["wake"]["count"] == 500


def test_extremes_stay_in_the_table() -> None:
    histograms = StageHistograms(grace_s=0.0)
    histograms.add(records(np.array([-5, 0, 3, 400_000_000])), 0)
    found = histograms.summary()["wake"]
    assert (found["count"], found["max_us"]) == (4, 400_000.0)
    assert found["p50_us"] == EDGES_NS[0] / 1000


def test_empty_histogram_is_zero() -> None:
    assert StageHistograms(0.0).summary()["read"] == {"count": 0, "p50_us": 0.0, "p99_us": 0.0, "p999_us": 0.0, "max_us": 0.0}


@pytest.mark.parametrize("stage", STAGES)
def test_clear_begins_anew(stage: str) -> None:
    histograms = StageHistograms(grace_s=0.0)
    histograms.add(records(np.full(10, 100)), 0)
    histograms.clear()
    assert histograms.summary()[stage]["count"] == 0
