"""`rig identify` on simulated boards whose mass, friction and delay the step does not know."""

import pytest
from models import board_params, device_params, servo_params

from hapticd.errors import AnalysisError, CommandError
from hapticd.params import ScaleParams, TouchParams
from hapticd.rig.identify import measure
from hapticd.zwidth.lockstep import LockStepBench

STOPS = {"lower_stop_m": -0.05, "upper_stop_m": 0.05}
MASS_KG = 0.0093
VISCOUS = 0.41
COULOMB_N = 0.045
SEEN = "rig step: {} 1.0 N (95 %: 0.995 to 1.005); rig/x.npz 0123"


def nothing(request):
    """Nobody is there who would do what is asked."""


def bench(device=None, **board):
    touch = TouchParams(coulomb_n=COULOMB_N, static_n=1.1 * COULOMB_N)
    given = {"mass_kg": MASS_KG, "viscous_ns_per_m": VISCOUS, "touch": touch, **STOPS, **board}
    return LockStepBench(
        servo_params(device=device_params(**(device or {}))), board_params(**given)
    )


def scale(per_count, name):
    return ScaleParams(per_count, source=SEEN.format(name))


def calibrated():
    plain = device_params()
    return {
        "force": scale(plain.force.per_count, "force.full_scale_n"),
        "probe_torque": scale(plain.probe_torque.per_count, "probe_torque.full_scale_n"),
        "position": scale(plain.position.per_count, "position.m_per_count"),
    }


@pytest.fixture(scope="module")
def found():
    """One board whose delay is 1.25 periods."""
    with bench(calibrated(), sample_phase=0.75, lag_periods=1) as rig:
        result = measure(rig, nothing)
        assert rig.status()["state"] == "disabled"
        assert not rig._leases
    return result


@pytest.mark.parametrize(
    ("name", "truth", "most"),
    [
        ("moving mass", MASS_KG, 0.01 * MASS_KG),
        ("viscous friction", VISCOUS, 0.1 * VISCOUS),
        ("Coulomb friction", COULOMB_N, 0.1 * COULOMB_N),
        ("delay", 1250.0, 50.0),
        ("probe skew", 0.0, 10.0),
        ("motor by probe", 1.0, 0.01),
    ],
)
def test_the_truth_lies_in_a_narrow_interval(found, name, truth, most):
    value = next(one for one in found.values if one.name == name)
    assert value.low <= truth <= value.high
    assert 0.5 * (value.high - value.low) <= most


def test_no_assumption_is_contradicted_where_all_hold(found):
    assert found.settled
    assert not [one.what for one in found.findings if one.verdict != "ok"]


def test_what_is_not_smoothed_is_written_without_smoothing(found):
    written = {(one.table, one.key): one.value for one in found.changes}
    assert "smoothing" not in written["model", "effects"]
    assert written["model.delay", "periods"] == pytest.approx(1.25, abs=0.01)


def test_signs_have_to_be_verified_first():
    with bench({"commissioning": True}) as rig, pytest.raises(AnalysisError, match="verified"):
        measure(rig, nothing)


def test_a_servo_that_is_enabled_is_left_alone():
    with bench() as rig:
        rig.enable()
        with pytest.raises(CommandError, match="enabled"):
            measure(rig, nothing)
        assert rig.status()["state"] == "enabled"


@pytest.mark.parametrize("way", ["fault", "interrupt"])
def test_whatever_ends_it_leaves_no_force(way):
    """The amplifier fails, or somebody presses Ctrl-C, while the handle is shaken."""
    with bench() as rig:
        started = rig.perturb_start

        def start(loop=False):
            receipt = started(loop)
            if way == "interrupt":
                raise KeyboardInterrupt
            rig.stop()
            return receipt

        rig.perturb_start = start
        with pytest.raises((AnalysisError, KeyboardInterrupt)):
            measure(rig, nothing)
        assert rig.status()["state"] != "enabled"
        rig.run(100)
        assert float(rig.newest["force_n"]) == 0.0
        assert not rig.newest["perturbing"]
        assert not rig._leases
