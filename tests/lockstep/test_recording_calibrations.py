"""Calibrations that cannot be relied on are named, and refused unless they are accepted."""

import dataclasses
import datetime
import json

import pytest
from support.boards import board_params
from support.models import device_params, servo_params

from hapticd.core.errors import AnalysisError
from hapticd.core.params import to_plain
from hapticd.recording.provenance import certificate_of, certificate_path, doubts
from hapticd.run.lockstep import LockStepClient
from hapticd.settings.build import servo_params as built
from hapticd.settings.load import load
from hapticd.settings.toml import shipped
from hapticd.zwidth.live import daemon_source, refuse_doubts
from hapticd.zwidth.sources import Trial

DAY = datetime.date(2026, 6, 1)
SCALES = ("position", "force", "active_damping", "probe_torque", "probe_velocity", "temperature")


def dated(date="2026-05-01", serial="", **others):
    """A real device whose scales were measured then, at that board; `others` are changes of it."""
    device = device_params(relies_on=("probe", "temperature"))
    scales = {
        name: dataclasses.replace(getattr(device, name), measured_on=date, serial=serial)
        for name in SCALES
    }
    return servo_params(simulated=False, device=dataclasses.replace(device, **scales | others))


def found(servo, day=DAY):
    return doubts(to_plain(servo), day)


def test_what_was_measured_lately_at_this_board_is_not_in_doubt():
    assert not found(dated())
    assert not found(dated(serial="SIM0001"))


def test_each_calibration_without_a_date_is_named_with_its_remedy():
    said = found(dated(date=""))
    assert [one.table for one in said] == list(SCALES)
    assert all("no date" in one.reason for one in said)
    assert said[0].remedy == "`hapticd rig encoder`"
    assert said[2].remedy == "`hapticd rig damping`"


@pytest.mark.parametrize(("factor", "doubted"), [(1.0, False), (1.005, False), (1.082, True)])
def test_damping_that_was_found_in_other_newtons_is_in_doubt(factor, doubted):
    """A gain of the motor that is measured after the damping makes another newton of it."""
    plain = to_plain(dated())
    plain["device"]["active_damping_with_force_n"] = 32767 * plain["device"]["force"]["per_count"]
    plain["device"]["force"]["per_count"] *= factor
    said = [str(one) for one in doubts(plain, DAY)]
    assert len(said) == doubted
    assert all(
        one.startswith("active_damping: it was found with a scale of force of") for one in said
    )


@pytest.mark.parametrize(("days", "old"), [(365, False), (366, True)])
def test_a_calibration_is_old_after_a_year(days, old):
    force = dataclasses.replace(
        device_params().force, measured_on=(DAY - datetime.timedelta(days)).isoformat()
    )
    said = found(dated(force=force))
    assert [one.table for one in said] == ["force"] * old
    assert all("366 days old" in str(one) and "365 days are the limit" in str(one) for one in said)


def test_the_device_file_says_how_old_is_too_old():
    assert len(found(dated(calibration_days=30))) == len(SCALES)
    assert not found(dated(calibration_days=31))


def test_a_calibration_of_another_board_is_named_with_both_serials():
    (said, *_) = found(dated(serial="OTHER"))
    assert str(said) == "position: it is of the board 'OTHER', this one is 'SIM0001'"


def test_a_date_after_today_is_no_date():
    assert "after today" in str(found(dated(date="2026-06-03"))[0])
    assert not found(dated(date="2026-06-02"))  # of a rig in another time zone


def test_nothing_is_asked_of_a_simulated_device():
    assert not found(dataclasses.replace(dated(date=""), simulated=True))


def test_what_a_device_does_not_use_is_not_asked_for():
    without = dated(date="", relies_on=(), active_damping_limit_ns_per_m=0.0)
    assert [one.table for one in found(without)] == ["position", "force"]
    probed = doubts(to_plain(without), DAY, probed=True)
    assert [one.table for one in probed][2:] == ["probe_torque", "probe_velocity"]


def test_refusal_names_every_one_and_the_way_out():
    with pytest.raises(AnalysisError, match=r"position: .*`hapticd rig motor`.*--uncalibrated"):
        refuse_doubts(found(dated(date="")))
    refuse_doubts(())


def test_a_copied_template_is_of_another_board(tmp_path):
    """Whoever writes his serial number over the template's has measured nothing by that."""
    text = (shipped("config") / "devices" / "example-board.toml").read_text()
    (tmp_path / "own.toml").write_text(text.replace('serial = "CHANGE-ME"', 'serial = "B7"', 1))
    (tmp_path / "hapticd.toml").write_text('device = "./own.toml"\n')
    servo = built(load(tmp_path / "hapticd.toml"), "x")
    assert {one.table for one in found(servo, datetime.date(2026, 1, 2))} == set(SCALES)
    assert servo.device_file == str(tmp_path / "own.toml")
    assert len(servo.device_file_sha256) == 64


# --- a trial --------------------------------------------------------------------------------------

OLD = {"date": "2001-01-01"}
# the probe of the device may push with 1 N
WEAK = dataclasses.replace(Trial().excitation, psd_n2_per_hz=1e-5)
TRIAL = Trial((50.0, 0.5, 0.0), seconds=5.0, excitation=WEAK)


def test_live_trial_refuses_what_cannot_be_relied_on_before_it_moves():
    with LockStepClient(dated(**OLD), board_params()) as bench:
        with pytest.raises(AnalysisError, match=r"position: it is \d+ days old"):
            daemon_source(bench)(TRIAL)
        assert bench.status().state == "disabled"


# --- the certificate of the rig -------------------------------------------------------------------


@pytest.fixture
def certified(tmp_path):
    """A servo whose device file has a certificate."""
    file = tmp_path / "own.toml"
    path = certificate_path(file, "a" * 64)
    path.parent.mkdir()
    said = {"date": "2026-05-02", "verdict": "verified", "device": {"file_sha256": "a" * 64}}
    path.write_text(json.dumps(said))
    return dataclasses.replace(dated(), device_file=str(file), device_file_sha256="a" * 64)


def test_the_certificate_of_this_device_file_is_told(certified):
    said = certificate_of(to_plain(certified))
    assert said["date"] == "2026-05-02"
    assert said["verdict"] == "verified"
    assert len(said["sha256"]) == 64
    assert said["changed"] == ""


def test_a_device_file_that_changed_since_is_said_to_have_changed(certified):
    said = certificate_of(to_plain(dataclasses.replace(certified, device_file_sha256="b" * 64)))
    assert said["device_file_sha256"] == "a" * 64
    assert "changed since" in said["changed"]


def test_without_a_certificate_nothing_is_told(certified, tmp_path):
    assert certificate_of(to_plain(dated())) is None
    next((tmp_path / "rig").iterdir()).write_text("{}")
    assert certificate_of(to_plain(certified)) is None
