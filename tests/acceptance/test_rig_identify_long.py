"""`rig identify` on simulated boards whose mass, friction and delay the step does not know."""

import shutil
from dataclasses import replace
from datetime import date

import numpy as np
import pytest
from support.models import device_params
from support.rig_identify import COULOMB_N, MASS_KG, VISCOUS, bench, nothing
from support.tree import ROOT

from hapticd.core.errors import AnalysisError
from hapticd.model.compose import compose
from hapticd.model.linearise import Perturbation
from hapticd.model.loop import spectral_radius
from hapticd.model.predict import predict, predicted_impedance
from hapticd.rig.certificate import write_changes
from hapticd.rig.steps.identify import measure
from hapticd.run.lockstep import LockStepClient, scene_params
from hapticd.settings import build
from hapticd.settings.scene import load_scene
from hapticd.zwidth.sources import device_scene, display

DEVICES = ROOT / "config" / "devices"


def calibrated():
    plain = device_params()
    return {
        name: replace(one, half_width_95=0.005 * one.per_count)
        for name in ("force", "probe_torque", "position")
        for one in [getattr(plain, name)]
    }


@pytest.fixture(scope="module")
def found():
    """One board whose delay is 1.25 periods."""
    with bench(calibrated(), sample_phase=0.75, lag_periods=1) as rig:
        result = measure(rig, nothing)
        assert rig.status().state == "disabled"
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


SCENE = """\
title = "two masses, and a filter behind the converter"
device = "weir2008"
effects = [
  "probe", "coupling", "viscous", "coulomb", "delay", "smoothing",
  "encoder", "force_dac", "probe_adc", "saturation",
]
[model.coupling]
stiffness_n_per_m = 1.2e4
[model.smoothing]
corner_hz = 200.0
"""


@pytest.fixture(scope="module")
def two_masses(tmp_path_factory):
    """What is found on a device of two masses, its truth, and the model of the file that was
    written.
    """
    folder = tmp_path_factory.mktemp("two")
    scene = folder / "scene.toml"
    scene.write_text(SCENE, encoding="utf-8")
    with LockStepClient(*scene_params(scene)) as rig:
        result = measure(rig, nothing)
    file = folder / "device.toml"
    shutil.copy(DEVICES / "example-board.toml", file)
    write_changes(file, result.changes, "rig identify", date(2026, 11, 22))
    written = device_scene(str(file))
    assert written is not None
    return result, compose(load_scene(scene)), display(written).model


def limit_n_per_m(model, stable):
    """The stiffness at which passivity, or stability alone, ends under 0.3 N s/m."""
    stiffness = np.geomspace(20.0, 2000.0, 200)
    points = np.column_stack((stiffness, np.full(200, 0.3), np.zeros(200)))
    if stable:
        good = spectral_radius(model, points) < 1.0
    else:
        good = predict(model, points, perturbation=Perturbation()).passive
    return stiffness[np.argmin(good)]


def test_a_mass_that_yields_contradicts_one_rigid_mass_and_is_written(two_masses):
    result, truth, model = two_masses
    told = [one.what for one in result.findings if one.what.startswith("contradicted")]
    assert len(told) == 1
    assert "rigid" in told[0]
    resonance = next(one for one in result.values if one.name == "first resonance")
    rate = np.sqrt(1.2e4 * (1.0 / 0.0025 + 1.0 / 0.0055))
    assert resonance.low <= rate / (2.0 * np.pi) <= resonance.high
    assert model.mass_kg == pytest.approx(truth.mass_kg, rel=0.01)


@pytest.mark.parametrize("stable", [True, False])
def test_the_written_model_has_the_limits_of_the_device(two_masses, stable):
    _, truth, model = two_masses
    expected = limit_n_per_m(truth, stable)
    assert 30.0 < expected < 1500.0
    assert limit_n_per_m(model, stable) == pytest.approx(expected, rel=0.05)


def test_the_written_model_has_the_impedance_of_the_device(two_masses):
    _, truth, model = two_masses
    f = np.geomspace(3.0, 300.0, 60)
    found, true = (
        predicted_impedance(one, (200.0, 0.5, 0.0), f, perturbation=Perturbation())
        for one in (model, truth)
    )
    assert np.abs(found / true - 1.0).max() < 0.05


def test_a_motor_that_nobody_measured_is_not_taken_for_one(found, tmp_path):
    file = tmp_path / "device.toml"
    shutil.copy(DEVICES / "example-board.toml", file)
    unknown = [
        replace(one, value=1.0) if one.key == "torque_constant_nm_per_a" else one
        for one in found.changes
    ]
    device = write_changes(file, unknown, "rig identify", date(2026, 11, 22))
    assert device.model.table("motor").source == "inferred"
    assert build.device_params(device).motor_n_per_a == device.home.current_n_per_a


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
        assert rig.status().state != "enabled"
        rig.run(100)
        assert float(rig.newest["force_n"]) == 0.0
        assert not rig.newest["perturbing"]
        assert not rig._leases
