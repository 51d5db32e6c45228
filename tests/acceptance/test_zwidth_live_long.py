"""A live trial that somebody meddles with: named, never judged as what it was not, and always
left disabled.
"""

from dataclasses import replace

import numpy as np
import pytest
from test_zwidth_live import RIGID, SECONDS, Looped, flown

from hapticd.core.errors import AnalysisError
from hapticd.mailbox.layout import Command, Value
from hapticd.model.params import HandParams, TouchParams
from hapticd.run.lockstep import LockStepClient, scene_params
from hapticd.zwidth.live import daemon_source
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.store import EndReason
from hapticd.zwidth.trial import TrialParams, plan_trial, run_trial


@pytest.fixture
def rigid(tmp_path):
    path = tmp_path / "rigid.toml"
    path.write_text(RIGID)
    return path


@pytest.mark.parametrize(
    "act",
    [
        lambda bench: bench.set(K=400.0, B=1.0, M=0.0, active_damping=0.0),
        lambda bench: bench.stack.do(
            Command.DAMPING, {Value.ACTIVE_DAMPING: 1.74, Value.ACTIVE_DAMPING_ON: 1.0}
        ),
        lambda bench: bench.perturb_stop(),
    ],
    ids=["environment", "active_damping", "perturbation"],
)
def test_trial_that_someone_changes_is_undecided(rigid, act):
    found = flown(rigid, act)
    assert found.verdict.answer == "undecided"
    assert found.verdict.stability == "stable"
    assert found.recorded.seconds < SECONDS
    assert "another client changed the environment or the perturbation" in str(found.verdict)


def test_trial_whose_force_comes_too_slowly_is_no_trial(rigid):
    """The handle was pushed far away when K = 800 N/m is enabled."""
    servo, board = scene_params(rigid)
    board = replace(board, touch=TouchParams(hands=(HandParams("push", force_n=1.0),)))
    plan = plan_trial(TrialParams(Trial((800.0, 1.0, 0.0), seconds=SECONDS)))
    with LockStepClient(servo, board) as bench:
        bench.run(2000)
        assert bench.newest["position_m"] > 0.015
        with pytest.raises(AnalysisError, match="slow start: the gain was still rising"):
            run_trial(plan, daemon_source(bench))
        assert bench.status().state == "disabled"


def test_trial_that_someone_ends_says_so(rigid):
    found = flown(rigid, lambda bench: bench.disable())
    assert str(found.recorded.ended) == "disabled: another client ended it"
    assert found.recorded.ended.reason is EndReason.DISABLED


@pytest.mark.parametrize(
    ("waveform_n", "looped"), [(None, False), (0.1 * np.sin(np.arange(4096)), True)]
)
def test_waveform_that_is_long_enough_ends_by_itself(rigid, waveform_n, looped):
    """A client that is killed leaves nothing that shakes for ever."""
    with Looped(*scene_params(rigid)) as bench:
        daemon_source(bench)(
            Trial((100.0, 1.0, 0.0), seconds=2.0, waveform_n=waveform_n),
            lambda what, done, total: None,
        )
        assert bench.looped is looped
