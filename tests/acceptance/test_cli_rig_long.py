"""`hapticd rig` from the command line, on a simulated rig in place of a daemon."""

from pathlib import Path

import pytest
from support.cli_rig import at_the_rig

from hapticd.cli.app import main
from hapticd.cli.rig import steps
from hapticd.settings.load import load
from hapticd.settings.toml import shipped


@pytest.fixture
def config(tmp_path: Path) -> Path:
    (tmp_path / "devices").mkdir()
    text = (shipped("config") / "devices" / "simulated.toml").read_text()
    text = text.replace("[force]\n", "[force]\nsign = -1\n")  # which is wrong
    (tmp_path / "devices" / "own.toml").write_text(text + "\n[commissioning]\n# not yet\n")
    file = tmp_path / "hapticd.toml"
    file.write_text('device = "own"\n')
    return file


@pytest.fixture
def verified_hand(monkeypatch: pytest.MonkeyPatch):
    yield from at_the_rig(monkeypatch, {})


def test_probe_writes_both_channels(config, verified_hand, monkeypatch):
    file = config.parent / "devices" / "own.toml"
    file.write_text((shipped("config") / "devices" / "simulated.toml").read_text())
    monkeypatch.setattr(steps, "asking", lambda yes: verified_hand.ask)
    told = ["rig", "probe", "--mass", "0.02", "--no-one-signal", "--config", str(config)]
    assert main([*told, "--yes", "--json"]) == 0
    device = load(config).device
    assert device.probe_torque.full_scale_n == pytest.approx(2.0, rel=0.01)
    assert device.probe_velocity.full_scale_m_per_s == pytest.approx(2.0, rel=0.005)
    assert device.limits.probe_n < 2.0  # its full scale is a little below that
    assert "rig probe: probe_torque.full_scale_n" in device.probe_torque.source
