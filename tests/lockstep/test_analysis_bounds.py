"""The bounds of K, B and M of a device, as its daemon and `zwidth predict` have them."""

import json
from pathlib import Path

import pytest

from hapticd.cli.app import main
from hapticd.guard.safe_region import passive_ranges
from hapticd.mailbox import files
from hapticd.protocol.limits import STATED, environment_limits
from hapticd.run import supervisor
from hapticd.settings.load import Override, load
from hapticd.settings.scene import load_scene
from hapticd.settings.toml import shipped
from hapticd.zwidth.sources import display


def resolved(device: str) -> dict[str, dict]:
    return supervisor.resolve(load(None, (Override(("device",), device, "--device"),)), "test")


def test_daemon_has_the_bounds_of_its_model_everywhere_alike():
    """At the ceiling of the damping circuit, 10 N s/m."""
    plain = resolved("weir2008")
    limits = plain[files.SERVO_JSON]["device"]["environment_limits"]
    scene = load_scene("fig4")
    passive = passive_ranges(display(scene).model, scene.environment.filters, 10.0)
    assert limits["highest"][0] == pytest.approx(10.0 * passive["K"][1], rel=0.05)
    assert limits["lowest"] == pytest.approx((-1e3, -100.0, 10.0 * passive["M"][0]), rel=0.05)
    assert limits["highest"][2] == pytest.approx(10.0 * passive["M"][1], rel=0.05)
    assert plain[files.GATEWAY_JSON]["servo"]["device"]["environment_limits"] == limits
    assert plain[files.GUARD_JSON]["limits"] == limits


def test_device_without_a_passive_range_has_the_stated_bounds():
    limits = resolved("simulated")[files.SERVO_JSON]["device"]["environment_limits"]
    assert limits["lowest"] == tuple(one.low for one in STATED.values())
    assert limits["highest"] == tuple(one.high for one in STATED.values())


def test_bounds_move_with_the_model():
    """Damping of the circuit buys virtual mass."""
    scene = load_scene("theory")
    few, many = (
        environment_limits(passive_ranges(display(scene).model, scene.environment.filters, level))
        for level in (1.0, 5.0)
    )
    assert 2.0 * few.highest[2] < many.highest[2]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["-M", "10"], "in kg; did you mean 0.010?"),
        (["-B", "1740"], "B = 1740 N s/m: beyond the limit -100.."),
        (["--active-damping", "1740"], "damping = 1740 N s/m: beyond the limit 0..10 N s/m"),
        (["--scene", "simulated", "-K", "60000"], "K = 60000 N/m: beyond the limit -1000..50000"),
    ],
)
def test_prediction_refuses_what_a_daemon_would(words, said, capsys):
    assert main(["zwidth", "predict", *words]) == 2
    told = " ".join(capsys.readouterr().err.replace("│", " ").split())
    assert said in told


def test_prediction_at_the_ceiling_of_active_damping_is_given(capsys):
    assert main(["zwidth", "predict", "-K", "100", "--active-damping", "10", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["active_damping_ns_per_m"] == 10.0


def test_prediction_knows_a_device_file_by_its_path(tmp_path: Path, capsys):
    file = tmp_path / "mine.toml"
    text = (shipped("config") / "devices" / "weir2008.toml").read_text()
    file.write_text(
        text.replace("active_damping_ns_per_m = 10.0", "active_damping_ns_per_m = 5.0", 1)
    )
    assert main(["zwidth", "predict", "--scene", str(file), "--active-damping", "6"]) == 2
    assert "0..5 N s/m" in capsys.readouterr().err
