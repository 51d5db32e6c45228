"""How long each stage of a tick takes: histograms with logarithmic bins, made from the stage times in the records.

40 bins a decade from 10 ns to 100 ms: a percentile is exact to 6 %, whatever its size. The first seconds after the start
(`grace_s`) are left out. Late events and lost slots are counters of the servo; a histogram cannot show what did not happen.
"""

import numpy as np

from hapticd.gateway.records import Records
from hapticd.mailbox.layout import STAGES
from hapticd.units import NS_PER_S, NS_PER_US

PER_DECADE, DECADES, LOWEST_NS = 40, 7, 10.0
EDGES_NS = LOWEST_NS * 10.0 ** (np.arange(PER_DECADE * DECADES + 1) / PER_DECADE)
BINS = len(EDGES_NS) + 1  # below the lowest edge, between edges, above the highest
PERCENTILES = {"p50_us": 0.5, "p99_us": 0.99, "p999_us": 0.999}


class StageHistograms:
    """One histogram per stage (layout.STAGES)."""

    def __init__(self, grace_s: float) -> None:
        self._grace_ns = grace_s * NS_PER_S
        self.clear()

    def clear(self) -> None:
        """Begin anew, for another servo life."""
        self._counts = np.zeros((len(STAGES), BINS), np.int64)
        self._max_ns = np.zeros(len(STAGES), np.int64)

    def add(self, records: Records, start_ns: int) -> None:
        """Count the ticks in `records` that came after the grace that began with the servo's life at `start_ns`."""
        settled = records[records["time_ns"] - start_ns >= self._grace_ns]
        if not settled.size:
            return
        times_ns = np.stack([settled[f"{stage}_ns"] for stage in STAGES])
        bins = np.searchsorted(EDGES_NS, times_ns, side="right") + np.arange(len(STAGES))[:, None] * BINS
        self._counts += np.bincount(bins.ravel(), minlength=self._counts.size).reshape(self._counts.shape)
        np.maximum(self._max_ns, times_ns.max(axis=1), out=self._max_ns)

    def summary(self) -> dict[str, dict[str, float]]:
        """{stage: {count, p50_us, p99_us, p999_us, max_us}}; a percentile is the upper edge of its bin, at most the maximum."""
        return {stage: self._one(row) for row, stage in enumerate(STAGES)}

    def _one(self, row: int) -> dict[str, float]:
        below = np.cumsum(self._counts[row])
        highest_us = self._max_ns[row] / NS_PER_US
        found: dict[str, float] = {"count": int(below[-1])}
        for name, share in PERCENTILES.items():
            place = min(int(np.searchsorted(below, share * below[-1])), len(EDGES_NS) - 1)
            found[name] = min(float(EDGES_NS[place]) / NS_PER_US, float(highest_us))
        return found | {"max_us": float(highest_us)}
