"""`rig motor --winding`: force per ampere, ohm and back-EMF of rigs that the step does not know."""

import pytest
from support.blind_rig import BlindRig
from support.blind_truth import NOMINAL

from hapticd.rig.steps import encoder, motor
from hapticd.rig.steps.winding import measure


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
    assert rig.bench.status().state == "disabled"


@pytest.mark.slow
def test_the_device_file_has_a_motor_then(found):
    rig, _ = found
    table = rig.settings.device.motor
    assert table.force_n_per_a == pytest.approx(rig.truth.motor_n_per_a, rel=0.02)
    assert table.lever_m == 0.01
    assert table.reference_c == pytest.approx(NOMINAL["ambient_c"], abs=4.0)
    assert table.measured_by == "rig motor"
