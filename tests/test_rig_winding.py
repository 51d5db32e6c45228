"""`rig motor --winding`: force per ampere, ohm and back-EMF of rigs that the step does not know."""

import numpy as np
import pytest
from support.blind_rig import BlindRig
from support.blind_truth import NOMINAL
from support.models import device_params

from hapticd.params import to_plain
from hapticd.rig import encoder, motor
from hapticd.rig.winding import concluded, measure

DEVICE = to_plain(device_params())


@pytest.fixture(scope="module", params=[41, 42])
def found(request):
    """A rig whose encoder and motor are measured, and what the winding shows then."""
    with BlindRig(request.param) as rig:
        rig.write(encoder.measure(rig.bench, rig.ask, encoder.Distance(0.01)))
        rig.restart()
        rig.write(motor.measure_sign(rig.bench, rig.ask))
        rig.restart()
        masses = motor.Masses((0.0, 0.025, 0.05, 0.075, 0.1))
        rig.write(motor.measure_gain(rig.bench, rig.ask, masses))
        rig.restart()
        result = measure(rig.bench, rig.ask, 0.01)
        rig.write(result)
        yield rig, result


@pytest.mark.slow
def test_a_blind_rigs_motor_lies_in_its_intervals(found):
    rig, result = found
    values = {one.name: one for one in result.values}
    warm_k = result.arrays["rests"][:, 3].mean() - NOMINAL["ambient_c"]
    emf = 32767 * NOMINAL["emf_velocity_m_per_s_per_count"] * rig.truth.emf_gain
    true = {
        "motor.force_n_per_a": rig.truth.motor_n_per_a,
        "motor.winding_ohm": NOMINAL["winding_ohm"] * (1.0 + 0.00393 * warm_k),
        "back-EMF": rig.truth.motor_n_per_a,
        "torque constant": 0.01 * rig.truth.motor_n_per_a,
        "emf_velocity.full_scale_m_per_s": emf,
    }
    for name, value in true.items():
        assert values[name].low <= value <= values[name].high, name
        assert values[name].high - values[name].low < 0.05 * value, name
    assert result.settled
    assert rig.bench.status()["state"] == "disabled"


@pytest.mark.slow
def test_the_device_file_has_a_motor_then(found):
    rig, _ = found
    table = rig.settings.device.motor
    assert table.force_n_per_a == pytest.approx(rig.truth.motor_n_per_a, rel=0.02)
    assert table.lever_m == 0.01
    assert table.reference_c == pytest.approx(NOMINAL["ambient_c"], abs=4.0)
    assert "rig motor" in table.source


def rests(force_n_per_a=1.65, ohm=1.6):
    current = np.linspace(-0.5, 0.5, 9)
    celsius = np.full(9, 21.0)
    return np.stack([force_n_per_a * current, current, ohm * current + 0.01, celsius], axis=1)


def moved(volt=1.65):
    speed = 0.05 * np.sin(np.linspace(0.0, 60.0, 250))
    return np.stack([speed, volt * speed - 0.02], axis=1)


def test_offsets_of_the_sensors_do_not_matter():
    values = {one.name: one.value for one in concluded(rests(), moved(), DEVICE).values}
    assert values["motor.force_n_per_a"] == pytest.approx(1.65)
    assert values["motor.winding_ohm"] == pytest.approx(1.6)
    assert values["back-EMF"] == pytest.approx(1.65)


@pytest.mark.parametrize("channel", [1, 2])
def test_a_channel_that_says_nothing_is_refused_by_name(channel):
    dead = rests()
    dead[:, channel] = 0.0
    result = concluded(dead, moved(), DEVICE)
    assert not result.settled
    assert not result.changes
    assert ("current", "voltage")[channel - 1] in result.findings[0].what


def test_a_current_of_the_wrong_sign_is_refused():
    result = concluded(rests(-1.65, 1.6), moved(), DEVICE)
    assert not result.settled
    assert "current" in result.findings[0].what


def test_scales_that_contradict_each_other_are_named():
    result = concluded(rests(), moved(2.0), DEVICE)
    assert any(one.verdict == "warning" and "voltage" in one.remedy for one in result.findings)


def test_a_handle_that_nobody_moved_is_refused():
    result = concluded(rests(), moved() * 0.01, DEVICE)
    assert not result.settled
