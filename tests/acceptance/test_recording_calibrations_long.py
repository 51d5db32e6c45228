"""Calibrations that cannot be relied on are named, and refused unless they are accepted."""

import dataclasses
import json
from contextlib import contextmanager

import pytest
from support.boards import board_params
from support.recorded import RecordedFlight, recorded_into
from test_recording_calibrations import OLD, SCALES, TRIAL, dated

from hapticd.cli import change
from hapticd.cli.app import main
from hapticd.recording.file import open_recording
from hapticd.recording.provenance import certificate_path
from hapticd.run.lockstep import LockStepClient
from hapticd.zwidth.live import daemon_source
from hapticd.zwidth.recorded import read_file
from hapticd.zwidth.store import read_summary
from hapticd.zwidth.trial import TrialParams, kept_trial, plan_trial, run_trial, write


def test_trial_that_accepts_it_says_so_in_its_verdict_and_wherever_it_is_read(tmp_path):
    plan = plan_trial(TrialParams(TRIAL))
    with LockStepClient(dated(**OLD), board_params()) as bench:
        result = run_trial(plan, daemon_source(bench, uncalibrated=True))
    assert "uncalibrated: position: it is" in str(result.verdict)
    write(tmp_path, result, {})
    kept = read_summary(tmp_path)
    assert len(kept["calibration_doubts"]) == len(SCALES)
    assert "uncalibrated: position" in str(kept_trial(tmp_path, kept, None).verdict)
    assert read_file(tmp_path).more["calibration_doubts"] == kept["calibration_doubts"]


def test_trial_of_a_simulated_device_says_nothing_of_it():
    simulated = dataclasses.replace(dated(date=""), simulated=True)
    with LockStepClient(simulated, board_params()) as bench:
        recorded = daemon_source(bench)(TRIAL)
    assert recorded.more["calibration_doubts"] == []


def test_trial_live_takes_uncalibrated_devices_when_asked(monkeypatch, tmp_path, capsys):
    @contextmanager
    def connected(instance, timeout_s=2.0):
        with LockStepClient(dated(**OLD), board_params()) as bench:
            yield bench

    monkeypatch.setattr(change, "connect", connected)
    words = ["zwidth", "trial", "live", "-K", "50", "-B", "0.5", "--seconds", "5", "--psd", "1e-5"]
    assert main([*words, "--out", str(tmp_path / "a")]) == 65
    assert "--uncalibrated" in capsys.readouterr().err
    assert main([*words, "--uncalibrated", "--out", str(tmp_path / "b")]) == 0
    assert "uncalibrated: position" in capsys.readouterr().out


def test_recording_names_them_and_so_does_the_trial_in_it(tmp_path):
    with RecordedFlight(dated(**OLD)) as run:
        run.move()
        run.fly(1500)
        recorded_into(tmp_path / "run.h5", run)
    with open_recording(tmp_path / "run.h5") as recording:
        attributes = recording.attributes
    said = json.loads(attributes["calibration_doubts"])
    assert said[0].startswith("position: it is")
    assert len(said) == len(SCALES)
    assert attributes["certificate"] == ""
    assert read_file(tmp_path / "run.h5").more["calibration_doubts"] == said


@pytest.fixture
def certified(tmp_path):
    """A servo whose device file has a certificate."""
    file = tmp_path / "own.toml"
    path = certificate_path(file, "a" * 64)
    path.parent.mkdir()
    said = {"date": "2026-05-02", "verdict": "verified", "device": {"file_sha256": "a" * 64}}
    path.write_text(json.dumps(said))
    return dataclasses.replace(dated(), device_file=str(file), device_file_sha256="a" * 64)


def test_trial_carries_the_certificate(certified):
    with LockStepClient(certified, board_params()) as bench:
        recorded = daemon_source(bench, uncalibrated=True)(TRIAL)
    assert recorded.more["certificate"]["verdict"] == "verified"
