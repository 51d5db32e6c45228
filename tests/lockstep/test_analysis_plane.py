"""The K-B plane against the theorem's own requirement and the ranges that a verdict names."""

from typing import Any

import numpy as np
import pytest
from support.guard_device import VISCOUS_NS_PER_M, rigid_judge, setup_of, shipped_judge

from hapticd.guard.judge import Judge
from hapticd.model.theorem import required_damping

LEVEL = 1.74


def plane(judge: Judge, delay: float = 0.0, level: float = LEVEL, **target: float) -> Any:
    asked = {"K": 0.0, "B": 0.0, "M": 0.0, **target}
    request = {"ask": "plane", "basis": "theorem", "margin_ns_per_m": 0.0, "level_on": level}
    return judge.answer({**request, "delay_periods": delay, "target": asked})["plane"]


@pytest.mark.parametrize("mass_kg", [0.0, 0.002])
def test_edges_of_a_rigid_device_need_all_the_damping_there_is(mass_kg: float) -> None:
    found = plane(rigid_judge(), M=mass_kg)
    step = (found["B"][1] - found["B"][0]) / 40
    for edge, inwards in (("low", 1.0), ("high", -1.0)):
        columns = [place for place, value in enumerate(found["without"][edge]) if value is not None]
        edges = np.array([found["without"][edge][place] for place in columns])
        points = np.column_stack(
            (np.array(found["K"])[columns], edges, np.full(len(columns), mass_kg))
        )
        assert len(columns) > 5
        assert (required_damping(points)[0] <= VISCOUS_NS_PER_M + 1e-3).all()
        points[:, 1] -= inwards * step / 16
        assert (required_damping(points)[0] >= VISCOUS_NS_PER_M - 1e-3).all()


def test_axis_ends_beyond_the_stiffest_that_is_safe() -> None:
    """Colgate and Schenkel: b > K T / 2 with B = 0, no delay; the set ends at twice that for the
    B that serves it best.
    """
    found = plane(rigid_judge(2.0), level=0.0)
    stiffest = max(
        stiffness
        for stiffness, low in zip(found["K"], found["with"]["low"], strict=True)
        if low is not None
    )
    assert stiffest >= 2.0 * 2.0 / 1e-3 * 0.95
    assert found["with"]["low"][-1] is None


def test_the_point_that_is_in_force_lies_inside_the_axes() -> None:
    found = plane(shipped_judge(), K=4000.0, B=5.0)
    assert found["K"][-1] > 4000.0
    assert found["B"][1] > 5.0


def test_a_device_without_a_model_has_no_plane_and_says_why() -> None:
    answer = Judge(setup_of(None)).answer(
        {
            "ask": "plane",
            "basis": "theorem",
            "margin_ns_per_m": 0.0,
            "delay_periods": 0.0,
            "target": {},
            "level_on": 0.0,
        }
    )
    assert answer["plane"] is None
    assert "no model" in answer["text"]
