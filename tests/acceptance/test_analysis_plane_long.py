"""The K-B plane against the theorem's own requirement and the ranges that a verdict names."""

import pytest
from support.guard_device import change, shipped_judge
from test_analysis_plane import LEVEL, plane


def test_active_damping_makes_it_larger_and_the_verdict_names_the_same_edges() -> None:
    judge = shipped_judge()
    found = plane(judge, delay=0.375)
    without = [low is not None for low in found["without"]["low"]]
    damped = [low is not None for low in found["with"]["low"]]
    assert sum(damped) > 3 * sum(without) > 0
    allowed = change(judge, {"K": 0.0, "active_damping": LEVEL}, delay_periods=0.375)["verdict"][
        "allowed"
    ]
    edges = [found["with"][edge][0] for edge in ("low", "high")]
    assert edges == pytest.approx(allowed["B"], abs=0.01)
