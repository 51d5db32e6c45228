"""`rig verify`: known parts as the probe sees them, and the certificate."""

import dataclasses
import json
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.rig_hand import Hand
from support.rig_verify import EMF, FREE, SHORT, nothing, verified

from hapticd.cli.rig import steps
from hapticd.core.params import to_plain
from hapticd.recording.provenance import certificate_beside, certificate_of
from hapticd.rig.certificate import page
from hapticd.rig.steps.verify import measure
from hapticd.settings.load import load
from hapticd.settings.toml import shipped


def told(result):
    return {one.what.partition(":")[0]: one for one in result.findings}


def test_a_display_as_it_should_be_is_verified_and_left_disabled():
    with Hand(**FREE) as hand:
        result = measure(hand.bench, nothing, SHORT)
        assert hand.bench.status().state == "disabled"
    assert result.settled
    assert [one.name for one in result.values] == [
        "rendered spring",
        "rendered damper",
        "rendered mass",
    ]
    for value, size in zip(result.values, (60.0, 1.0, 0.004), strict=True):
        assert value.low < size * 1.02
        assert size * 0.98 < value.high
        assert value.high - value.low < 0.15 * size
    assert told(result)["timing"].verdict == "ok"


def test_a_motor_stronger_than_its_calibration_is_refused():
    with Hand(**FREE) as hand:
        hand.gain = 1.2
        result = measure(hand.bench, nothing, SHORT)
    found = told(result)
    assert not result.settled
    assert found["rendered spring"].verdict == found["rendered damper"].verdict == "refused"
    assert "hapticd rig motor" in found["rendered spring"].remedy


# --- the certificate ------------------------------------------------------------------------------


@pytest.fixture
def config(tmp_path: Path) -> Path:
    (tmp_path / "devices").mkdir()
    text = (shipped("config") / "devices" / "simulated.toml").read_text()
    (tmp_path / "devices" / "own.toml").write_text(text)
    file = tmp_path / "hapticd.toml"
    file.write_text('device = "own"\n')
    return file


@pytest.fixture
def hand(config, monkeypatch):
    """A rig whose daemon was started with the device file of `config`."""
    settings = load(config)
    with Hand({"emf_velocity": EMF}, **FREE) as found:
        bench = found.bench
        bench._servo = dataclasses.replace(
            bench._servo,
            device_file=str(settings.device_file),
            device_file_sha256=settings.device_file_sha256,
        )

        @contextmanager
        def connected(instance):
            yield bench

        monkeypatch.setattr(steps, "connect", connected)
        monkeypatch.setattr(steps, "PAUSE_S", 0.0)
        yield found


def test_certificate_says_what_it_is_of_and_what_was_not_verified(config, hand, capsys):
    before = load(config).device_file.read_bytes()
    assert verified(config) == 0
    assert load(config).device_file.read_bytes() == before
    settings = load(config)
    folder = settings.device_file.parent / "rig"
    stem = f"own-certificate-{settings.device_file_sha256[:12]}"
    said = json.loads((folder / f"{stem}.json").read_text())
    assert said["verdict"] == "verified"
    assert said["device"]["file_sha256"] == settings.device_file_sha256
    assert (said["device"]["serial"], said["device"]["firmware"]) == ("SIM0001", "1.0")
    assert said["device"]["life"] == hand.life
    assert said["values"][0]["name"] == "rendered spring"
    assert {one["table"] for one in said["calibrations"]} >= {"position", "force", "probe_torque"}
    assert said["software"]["hapticd"]
    assert said["software"]["libraries"]["numpy"]
    assert any("emergency stop" in one for one in said["not_verified"])
    text = (folder / f"{stem}.html").read_text()
    assert "SIMULATED" in text
    assert settings.device_file_sha256 in text
    assert "http" not in text
    assert "certificate" in capsys.readouterr().err


def test_recordings_find_it_until_the_device_file_changes(config, hand):
    assert verified(config) == 0
    servo = to_plain(hand.bench._servo)
    assert certificate_of(servo)["verdict"] == "verified"
    assert certificate_of(servo)["changed"] == ""
    file = load(config).device_file
    file.write_text(file.read_text() + "\n# another line\n")
    later = certificate_beside(file, load(config).device_file_sha256)
    assert "changed since" in later["changed"]
    assert later["verdict"] == "verified"


def test_a_display_that_is_off_gets_a_certificate_that_says_so(config, hand):
    hand.gain = 1.2
    assert verified(config) == 4
    assert certificate_of(to_plain(hand.bench._servo))["verdict"] == "not verified"


def test_page_shows_text_and_no_markup_of_others(config, hand):
    assert verified(config) == 0
    path = next((load(config).device_file.parent / "rig").glob("*.json"))
    said = json.loads(path.read_text())
    said["device"]["name"] = "<script>"
    assert "<script>" not in page(said)
