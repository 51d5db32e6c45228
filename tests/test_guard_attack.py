"""The attack on the guard, on a few sequences: what it finds in guards that are none, and nothing
in ours. Then ways to get past it, one by one.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

from whole_tick import Display, Point, radius

from benchmarks.guard_attack import SHIPPED, WEIR, Found, attack, chunks, device
from hapticd.analysis.loop import spectral_radius

FEW = [0, 2, 3, 6, 7, 8, 10, 11]  # on the shipped display, its delay known
POINTS = [(100.0, 1.0, 0.01), (500.0, 2.0, 0.0), (20.0, -0.3, -0.004), (900.0, 0.0, 0.008)]


@pytest.mark.parametrize(("name", "known"), [("simulated", SHIPPED), ("weir2008", WEIR)])
def test_second_opinion_has_the_numbers_of_the_device_file(name: str, known: Display) -> None:
    model = device(name).bench.model
    for level in (0.0, 1.74, 4.0):
        own = radius(known, [Point(*one, level) for one in POINTS])
        theirs = spectral_radius(model, np.array(POINTS), level)
        assert own == pytest.approx(theirs, abs=1e-7)


def answering(action: str, request: dict[str, Any]) -> dict[str, Any]:
    stage = {"change": request["change"], "damping_at_least": None, "after_ramps": False}
    stages = [stage] if action == "apply" else []
    return {"action": action, "stages": stages, "verdict": {"clamped": False, "text": "blind"}}


def test_guard_that_lets_everything_pass_is_found_out() -> None:
    found = attack(FEW[:3], lambda request: answering("apply", request))
    assert len(found.unsafe) > 10
    assert not found.refused


def test_guard_that_refuses_everything_refuses_what_is_safe() -> None:
    found = attack(FEW[:1], lambda request: answering("refuse", request))
    assert not found.unsafe
    assert len(found.refused) == found.safe_further >= 4


@pytest.fixture(scope="module")
def some() -> Found:
    return attack(FEW)


def test_nothing_comes_into_force_that_a_hand_would_shake(some: Found) -> None:
    assert some.points > 200
    assert not some.unsafe


def test_few_requests_are_refused_that_no_hand_would_shake_further_out(some: Found) -> None:
    assert some.safe_further > 30
    assert len(some.refused) <= 0.05 * some.safe_further


def test_every_sequence_is_flown_once_on_one_device() -> None:
    groups = chunks(100, 30)
    assert sorted(seed for group in groups for seed in group) == list(range(30, 130))
    assert all(len({seed % 5 == 4 for seed in group}) == 1 for group in groups)
