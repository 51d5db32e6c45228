"""Trials from every source: engine, file, and the whole stack in lock-step; the sentinel; run
folders.
"""

from dataclasses import replace

import pytest
from support.measured_scenes import RIGID

from hapticd.run.lockstep import scene_params
from hapticd.run.lockstep_client import LockStepClient
from hapticd.zwidth.live import daemon_source
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.trial import TrialParams, judged, plan_trial


@pytest.fixture
def rigid(tmp_path):
    path = tmp_path / "rigid.toml"
    path.write_text(RIGID)
    return path


@pytest.fixture
def weak(rigid):
    """The rigid display with a force limit of 0.16 N."""
    servo, board = scene_params(rigid)
    with LockStepClient(
        replace(servo, safety=replace(servo.safety, force_limit_n=0.16)), board
    ) as bench:
        yield bench


def test_lockstep_trial_whose_command_saturates_is_ended_and_named(weak):
    """Passive and calm, but the force it commands is cut at 0.16 N: what was asked is not
    rendered.
    """
    trial = Trial((100.0, 1.0, 0.002), seconds=60.0)
    found = daemon_source(weak)(trial, lambda *_: None)
    assert weak.status().state == "disabled"
    assert str(found.ended) == "saturation: the command reached its limit of 0.16 N"
    assert 5.0 < found.seconds < 60.0
    assert found.max_command_n == found.command_limit_n == 0.16
    verdict = judged(plan_trial(TrialParams(trial)), found).verdict
    assert verdict.answer == "undecided"
    assert "command saturated at 0.16 N; lower the perturbation or the stiffness" in str(verdict)
