"""The attack on the guard, on a few sequences: what it finds in guards that are none, and nothing
in ours. Then ways to get past it, one by one.
"""

import numpy as np
import pytest
from support.whole_tick import Display, Point, radius

from benchmarks.guard_attack import SHIPPED, WEIR, chunks, device
from hapticd.model.loop import spectral_radius

POINTS = [(100.0, 1.0, 0.01), (500.0, 2.0, 0.0), (20.0, -0.3, -0.004), (900.0, 0.0, 0.008)]


@pytest.mark.parametrize(("name", "known"), [("simulated", SHIPPED), ("weir2008", WEIR)])
def test_second_opinion_has_the_numbers_of_the_device_file(name: str, known: Display) -> None:
    model = device(name).bench.model
    for level in (0.0, 1.74, 4.0):
        own = radius(known, [Point(*one, level) for one in POINTS])
        theirs = spectral_radius(model, np.array(POINTS), level)
        assert own == pytest.approx(theirs, abs=1e-7)


def test_every_sequence_is_flown_once_on_one_device() -> None:
    groups = chunks(100, 30)
    assert sorted(seed for group in groups for seed in group) == list(range(30, 130))
    assert all(len({seed % 5 == 4 for seed in group}) == 1 for group in groups)
