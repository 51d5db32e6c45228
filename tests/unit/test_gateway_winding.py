"""What `status` says of the winding's compensation, against Ohm's law by hand."""

from dataclasses import replace
from math import nan

import pytest
from support.gateway_stand_in import setup
from support.winding_table import TABLE

from hapticd.gateway.tick_times import compensation

DEVICE = replace(setup().servo.device, resistance=TABLE, active_damping_limit_ns_per_m=4.0)
COUNT = 8192  # of 32767, which add 0.8 ohm


def test_compensated_and_left_resistance_and_loop_gain_by_hand() -> None:
    record = {"resistance_count": COUNT, "winding_c": 60.0, "active_damping_effect_ns_per_m": 1.74}
    found = compensation(record, DEVICE)
    assert found is not None
    copper_ohm = 1.6 * (1 + 0.00393 * 40.0)
    compensated_ohm = 1.5 + 0.8 * COUNT / 32767
    assert found["winding_ohm"] == pytest.approx(copper_ohm)
    assert found["compensated_ohm"] == pytest.approx(compensated_ohm)
    assert found["residual_ohm"] == pytest.approx(copper_ohm - compensated_ohm)
    gain = (copper_ohm - compensated_ohm) / 1.65**2
    assert found["loop_gain"] == pytest.approx(1.74 * gain)
    assert found["loop_gain_at_ceiling"] == pytest.approx(4.0 * gain)


def test_without_a_sensor_only_what_is_compensated_is_known() -> None:
    record = {"resistance_count": COUNT, "winding_c": nan, "active_damping_effect_ns_per_m": 1.74}
    found = compensation(record, DEVICE)
    assert found is not None
    assert found["compensated_ohm"] == pytest.approx(1.5 + 0.8 * COUNT / 32767)
    assert found["winding_ohm"] is None
    assert found["residual_ohm"] is None
    assert found["loop_gain"] is None


def test_nothing_is_said_without_a_table_or_a_record() -> None:
    record = {"resistance_count": 0, "winding_c": 20.0}
    assert compensation(record, setup().servo.device) is None
    assert compensation({}, DEVICE) is None
