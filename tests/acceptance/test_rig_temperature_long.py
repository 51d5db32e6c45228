"""`rig temperature`: closed forms on made-up counts, and the simulated board's sensor."""

import numpy as np
import pytest
from support.rig_hand import Hand
from test_rig_temperature import DEVICE, counts, holds, refused, shaken, told

from hapticd.core.errors import AnalysisError
from hapticd.rig.steps.winding import (
    KnownTemperatures,
    analyse_back_emf,
    analyse_temperature,
    measure_temperature,
)


def test_errors_of_the_thermometer_stay_inside_nineteen_times_in_twenty():
    random = np.random.default_rng(1)
    scale = offset = 0
    for _ in range(300):
        truth = np.array([20.0, 50.0])
        read = truth + 0.5 / 1.96 * random.standard_normal(2)
        values = told(
            analyse_temperature(counts(*truth, offset=40.0), KnownTemperatures(tuple(read)), DEVICE)
        )
        scale += holds(values["temperature.c_per_count"], 0.01)
        offset += holds(values["temperature.offset_count"], 40.0)
    assert 275 <= scale <= 295
    assert 275 <= offset <= 295


def test_back_emf_lies_in_its_interval_nineteen_times_in_twenty():
    exact = DEVICE | {"position": {"per_count": 1.0, "half_width_95": 0.0}}
    hits = 0
    for seed in range(100):
        result = analyse_back_emf(shaken(1.1, seed=seed, noise=20.0), exact)
        hits += holds(told(result)["emf_velocity.full_scale_m_per_s"], 2.2)
    assert 90 <= hits <= 99


def test_the_sensor_of_the_simulated_board_agrees_with_its_room():
    with Hand() as hand:
        result = measure_temperature(
            hand.bench, hand.ask, KnownTemperatures((22.0,)), with_shake=False
        )
        assert hand.bench.status().state == "disabled"
    assert result.settled
    assert holds(told(result)["temperature.offset_count"], 0.0)


def test_a_board_without_the_sensor_is_told_so():
    with Hand(lacks=("temperature",)) as hand, pytest.raises(AnalysisError, match="no temperature"):
        measure_temperature(hand.bench, hand.ask, KnownTemperatures((22.0,)))


def test_a_room_that_cannot_be_is_refused_before_anybody_shakes_the_handle():
    asked = []
    with Hand() as hand:
        result = measure_temperature(
            hand.bench, lambda one: asked.append(one.action), KnownTemperatures((295.0,))
        )
    assert "degC" in refused(result)[0].what
    assert asked == ["let go"]
