"""Trials from every source: engine, file, and the whole stack in lock-step; the sentinel; run
folders.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.measured_scenes import RIGID
from test_zwidth_trial import lands_within

from hapticd.model.compose import compose
from hapticd.model.predict import predicted_impedance
from hapticd.run.lockstep import LockStepClient, scene_params
from hapticd.settings.scene import load_scene
from hapticd.zwidth.live import daemon_source
from hapticd.zwidth.simulated import engine_source
from hapticd.zwidth.sources import Trial, stepped_sine
from hapticd.zwidth.store import (
    EndReason,
)
from hapticd.zwidth.trial import TrialParams, judged, plan_trial, run_trial


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


@pytest.mark.parametrize("active_damping_ns_per_m", [0.0, 1.74])
def test_lockstep_trial_lands_within_its_interval_of_the_engine(active_damping_ns_per_m):
    """The calibrated display of fig. 7, undamped and damped: 25 s by the whole stack and by the
    engine, of other noise.
    """
    scene = load_scene("fig7")
    trial = Trial((50.0, 2.0, 0.0), active_damping_ns_per_m, seconds=25.0)
    plan = plan_trial(TrialParams(trial, scene))
    by_engine = run_trial(plan, engine_source(scene))
    with LockStepClient(*scene_params("fig7")) as bench:
        live = run_trial(plan, daemon_source(bench))
        assert bench.status().state == "disabled"
    assert live.recorded.seconds == 25.0
    assert live.recorded.more["lost_samples"] == 0
    assert live.recorded.simulated
    assert live.verdict.answer == by_engine.verdict.answer == "passive"
    assert lands_within(live, by_engine) > 0.9
    assert live.recorded.command_limit_n == by_engine.recorded.command_limit_n == 8.0
    assert live.recorded.max_command_n == pytest.approx(by_engine.recorded.max_command_n, rel=0.3)


def test_lockstep_trial_of_a_runaway_loop_ends_early_and_disabled(rigid):
    """B T / m far beyond 2: the loop runs away, the trial ends at once, force off."""
    with LockStepClient(*scene_params(rigid)) as bench:
        found = daemon_source(bench)(Trial((0.0, 100.0, 0.0), seconds=20.0), lambda *_: None)
        assert bench.status().state != "enabled"
    assert found.ended.reason in (EndReason.ESCAPE, EndReason.SATURATION, EndReason.FAULT)
    assert found.seconds < 5.0


@pytest.mark.parametrize("whole_stack", [False, True])
def test_stepped_sine_agrees_with_the_exact_impedance_of_a_linear_display(rigid, whole_stack):
    """No friction: single sines give the predicted first harmonic to 1 % at 5..144 Hz, by the
    engine and by the whole stack.
    """
    scene = load_scene(rigid)
    trial = Trial((100.0, 1.0, 0.002))
    f = (5.0, 21.0, 55.0, 144.0)
    if whole_stack:
        with LockStepClient(*scene_params(rigid)) as bench:
            found = stepped_sine(trial, daemon_source(bench), frequency_hz=f)
    else:
        found = stepped_sine(trial, engine_source(scene), frequency_hz=f)
    exact = predicted_impedance(
        compose(scene), trial.environment, np.array(f), 0.0, scene.environment.filters
    )
    assert np.abs(found.impedance_ns_per_m / exact - 1.0).max() < 0.01


def test_loop_that_ran_away_at_once_ends_its_lockstep_trial_as_an_escape(rigid):
    with LockStepClient(*scene_params(rigid)) as bench:
        found = daemon_source(bench)(Trial((0.0, 100.0, 0.0), seconds=20.0), lambda *_: None)
    assert str(found.ended).startswith("escape: the command reached its limit of 8 N")
    assert found.seconds < 5.0


@pytest.mark.parametrize(
    ("scene", "environment"),
    [
        ("fig4", (4000.0, 0.0, 0.0)),
        ("fig4", (0.0, 12.0, 0.0)),
        ("fig4", (0.0, 0.0, 0.06)),
        ("rival", (3000.0, 0.0, 0.0)),
    ],
)
def test_escape_before_the_record_begins_is_found_at_the_limit_of_the_force(scene, environment):
    """Nothing grows any more; what moves the device is not the perturbation."""
    trial = Trial(environment, seconds=20.0)
    found = run_trial(plan_trial(TrialParams(trial)), engine_source(load_scene(scene)))
    assert str(found.recorded.ended).startswith(
        "escape: the command reached its limit of 8 N in a motion of its own"
    )
    assert found.verdict.answer == "not_passive"
