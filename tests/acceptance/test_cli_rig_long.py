"""`hapticd rig` from the command line, on a simulated rig in place of a daemon."""

import json
from pathlib import Path

import numpy as np
import pytest
from support.cli_rig import at_the_rig
from support.models import COUNT_N

from hapticd.cli.app import main
from hapticd.cli.rig import guided, steps
from hapticd.core.params import ScaleParams
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


@pytest.fixture
def hand(monkeypatch: pytest.MonkeyPatch):
    yield from at_the_rig(monkeypatch, {"force": ScaleParams(COUNT_N, -1), "commissioning": True})


def test_motor_writes_sign_and_verification_with_their_record(config, hand, capsys):
    assert load(config).device.commissioning.signs_verified is False
    assert main(["rig", "motor", "--yes", "--json", "--config", str(config)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["ok"]
    device = load(config).device
    assert device.force.sign == 1
    assert device.commissioning.signs_verified
    assert device.commissioning.serial == device.serial
    assert (device.commissioning.firmware, device.commissioning.life) == (
        "1.0",
        hand.life,
    )
    assert "# not yet" in load(config).device_file.read_text()
    (record,) = (config.parent / "devices" / "rig").iterdir()
    assert record.name in device.commissioning.source
    assert device.force.source == load(shipped("config") / "hapticd.toml").device.force.source
    with np.load(record) as kept:
        assert len(kept["position_m_0"]) > 100


def test_whoever_says_no_writes_nothing(config, hand, monkeypatch):
    before = load(config).device_file.read_bytes()
    monkeypatch.setattr(steps, "answer", lambda question: "no")
    assert main(["rig", "motor", "--config", str(config)]) == 0
    assert load(config).device_file.read_bytes() == before


def test_link_says_a_verdict_for_each_thing(hand, capsys, monkeypatch):
    monkeypatch.setattr("hapticd.rig.steps.link.SECONDS", 1.0)
    assert main(["rig", "link"]) == 0
    told = capsys.readouterr().out
    assert "ok: missing_in: 0" in told
    assert "ok: watchdog of the board: trips after" in told


def test_the_guided_path_does_each_step_that_is_wanted(config, hand, monkeypatch, capsys):
    """No link, no encoder, the motor's sign; and the file is written once yes was said."""
    monkeypatch.setenv("HAPTICD_CONFIG", str(config))
    monkeypatch.setattr(guided, "connect", steps.connect)
    said = iter(["no", "no", "yes", "", "yes"])
    monkeypatch.setattr(steps, "answer", lambda question: next(said))
    assert main(["rig"]) == 0
    assert load(config).device.commissioning.signs_verified
    assert "start it again" in capsys.readouterr().err
    assert not list(said)


def test_refused_signs_are_not_called_verified(config, hand, monkeypatch, capsys):
    monkeypatch.setenv("HAPTICD_CONFIG", str(config))
    monkeypatch.setattr(guided, "connect", steps.connect)
    said = iter(["no", "no", "yes", "", "no"])  # the last: write this? no
    monkeypatch.setattr(steps, "answer", lambda question: next(said))
    assert main(["rig"]) == 0
    told = capsys.readouterr().err
    assert "The signs are not verified yet" in told
    assert "start it again" not in told


def test_temperature_writes_the_count_of_0_degrees(config, hand):
    stated = ["rig", "temperature", "--at", "22", "--no-shake", "--config", str(config)]
    assert main([*stated, "--yes", "--json"]) == 0
    device = load(config).device
    assert abs(device.temperature.offset_count) < 1.0
    assert "temperature.offset_count" in device.temperature.source
    assert "rig" not in device.emf_velocity.source
