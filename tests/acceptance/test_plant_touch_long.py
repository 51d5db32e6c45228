"""What touches the simulated device: stops that yield, a bearing that sticks, hands. Against closed
forms; and nothing of it where it is not asked for.
"""

from math import sqrt

import pytest
from test_plant_touch import flown, plant_of

from hapticd.model.params import HandParams, TouchParams


def test_tremor_is_seeded_and_as_large_as_it_says():
    hand = HandParams("hold", stiffness_n_per_m=1e6, damping_ns_per_m=100.0, tremor_m=1e-4)

    def places(seed):
        return [
            x for x, _ in flown(plant_of(TouchParams(hands=(hand,)), seed=seed), (0, 0), 32_000)
        ]

    first = places(1)
    assert first == places(1)
    assert first != places(2)
    assert sqrt(sum(x * x for x in first) / len(first)) == pytest.approx(1e-4, rel=0.3)
