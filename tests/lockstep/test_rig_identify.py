"""`rig identify` on simulated boards whose mass, friction and delay the step does not know."""

from dataclasses import asdict, replace

import pytest
from support.models import device_params, servo_params
from support.rig_identify import bench, nothing

from hapticd.core.errors import AnalysisError, CommandError
from hapticd.rig.steps.identify import facts_of, measure


def test_signs_have_to_be_verified_first():
    with bench({"commissioning": True}) as rig, pytest.raises(AnalysisError, match="verified"):
        measure(rig, nothing)


def test_a_servo_that_is_enabled_is_left_alone():
    with bench() as rig:
        rig.enable()
        with pytest.raises(CommandError, match="enabled"):
            measure(rig, nothing)
        assert rig.status().state == "enabled"


def test_the_lever_of_the_motor_is_written_with_its_torque():
    motor = {"motor_n_per_a": 1.65, "winding_ohm": 1.6, "motor_lever_m": 0.02}
    servo = servo_params(device=replace(device_params(), **motor))
    written = facts_of(asdict(servo)).motor
    assert written["torque_constant_nm_per_a"] == pytest.approx(0.033)
    assert written["lever_m"] == 0.02
