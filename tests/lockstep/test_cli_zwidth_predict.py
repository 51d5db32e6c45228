"""`hapticd zwidth predict`: what theory says of one environment, and where its parts differ."""

import json

import numpy as np
import pytest
from support.analysis_devices import rigid

from hapticd.cli.app import main
from hapticd.model.coupled import forecast
from hapticd.model.linearise import Perturbation
from hapticd.model.loop import PAPER_FILTERS
from hapticd.model.theorem import required_damping
from hapticd.settings.scene import load_scene
from hapticd.zwidth.sources import display

BAND = (2.0, 500.0)
REFUSED = ["-K", "-34", "-B", "-0.86", "-M", "0.0048", "--active-damping", "1.74"]
DIFFERING = ["-K", "800", "-B", "1", "-M", "0.020", "--active-damping", "1.74"]


def told(words, capsys):
    assert main(["zwidth", "predict", *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def said(words, capsys):
    assert main(["zwidth", "predict", *words]) == 0
    return capsys.readouterr().out


def test_negative_stiffness_is_refused_though_its_resistance_is_positive(capsys):
    found = told(REFUSED, capsys)
    assert found["prediction"]["margin_ns_per_m"] > 0.0
    assert found["spectral_radius"] > 1.0
    assert found["prediction"]["spectral_radius"] > 1.0
    assert found["refused"]
    assert not found["passive"]
    words = said(REFUSED, capsys)
    assert "refused: a negative K" in words
    assert "though Re Z >= 0 all over the band" in words
    assert "motion grows" in words
    doubles_s = np.log(2.0) / (np.log(found["spectral_radius"]) * 1000.0)
    assert f"motion grows, doubling in {doubles_s:.3g} s" in words


def test_safe_environment_has_no_hand(capsys):
    found = told(["--scene", "fig7"], capsys)
    assert found["environment"] == [50.0, 2.0, 0.0]
    assert found["active_damping_ns_per_m"] == 1.74
    assert found["withstands_every_hand"]
    assert found["hand"] is None
    assert found["theorem"]["passive"]
    assert "for every input and in every passive hand" in said(["--scene", "fig7"], capsys)


def test_unstable_environment_needs_no_hand(capsys):
    found = told(["-K", "3000"], capsys)
    assert found["hand"] is None
    assert not found["withstands_every_hand"]
    assert not found["passive"]
    assert "unstable by itself" in said(["-K", "3000"], capsys)


def test_what_is_left_out_is_zero_without_a_scene(capsys):
    found = told(["-K", "30"], capsys)
    assert found["environment"] == [30.0, 0.0, 0.0]
    assert found["active_damping_ns_per_m"] == 0.0
    assert "K 30 N/m, B 0 N s/m, M 0 g, active damping 0 N s/m" in said(["-K", "30"], capsys)


def test_prediction_is_that_of_a_map(capsys):
    found = told(["-K", "100", "-B", "1", "-M", "0.01"], capsys)
    fig4 = display(load_scene("fig4"))
    expected = fig4.predicted(np.array([[100.0, 1.0, 0.01]]), 0.0)
    assert found["recorded"]["margin_ns_per_m"] == pytest.approx(expected.margin_ns_per_m[0])
    assert found["recorded"]["worst_hz"] == pytest.approx(expected.worst_hz[0])


@pytest.mark.parametrize(
    "point", [(1000.0, 1.0, 0.0), (0.0, 3.0, 0.0), (3000.0, 0.0, 0.0), (4500.0, 0.0, 0.0)]
)
def test_theorem_of_a_rigid_device_is_colgate_and_schenkels(point):
    found = forecast(rigid(viscous=2.0), point, 0.0, PAPER_FILTERS, Perturbation(), BAND)
    assert found.theorem_margin == pytest.approx(2.0 - required_damping([point])[0][0], abs=2e-3)
    assert found.theorem_passive == (found.theorem_margin > 0.0)


@pytest.mark.parametrize(
    ("words", "code", "named"),
    [
        (["-K", "nan"], 2, "-K nan: a finite number of N/m"),
        (["-M", "inf"], 2, "-M inf: a finite number of kg"),
        (["--active-damping", "inf"], 2, "--active-damping inf"),
        (["--active-damping", "-1"], 2, "not in the range x>=0"),
        (["--scene", "nothing"], 78, "'nothing': no such scene"),
        (["--band", "500", "2"], 65, "band of 500..2 Hz"),
    ],
)
def test_slip_is_named(words, code, named, capsys):
    assert main(["zwidth", "predict", *words]) == code
    assert named in " ".join(capsys.readouterr().err.replace("│", " ").split())
