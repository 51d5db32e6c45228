"""One trial with the whole stack in lock-step, beside the engine."""

import numpy as np
import pytest

from hapticd.core.errors import AnalysisError
from hapticd.run.lockstep import MOST_S, run_lockstep


def test_trial_plays_the_forces_it_was_given() -> None:
    force = np.random.default_rng(1).normal(0.0, 0.2, 4000)
    trial = run_lockstep("theory", force, [(0.0, 0.0)])
    played = trial.torque_n[np.flatnonzero(trial.torque_n)[0] :]
    assert np.abs(played - force[: len(played)]).max() <= 0.51 * 2.0 / 32767
    assert (len(trial.position_m), len(trial.torque_n)) == (1000, 4000)


def test_trial_is_no_longer_than_the_waveform() -> None:
    with pytest.raises(
        AnalysisError, match=rf"in lock-step: the waveform holds {MOST_S:g} s; ask for less"
    ):
        run_lockstep("theory", np.zeros(round(4000 * MOST_S) + 1), [])
