"""One trial by the whole stack in lock-step, on the board given to the simulation."""

from hapticd.run.lockstep import LockStepClient, scene_params
from hapticd.settings.scene import load_scene
from hapticd.zwidth.live import daemon_source
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.trial import TrialParams, TrialResult, plan_trial, run_trial


def fig7_trial(board: type, seconds: float) -> TrialResult:
    """Run a trial of the calibrated display of fig. 7, damped. AssertionError if the board is not a
    `board`.
    """
    trial = Trial((50.0, 2.0, 0.0), 1.74, seconds=seconds)
    plan = plan_trial(TrialParams(trial, load_scene("fig7")))
    with LockStepClient(*scene_params("fig7")) as bench:
        assert isinstance(bench.stack.backend._port, board)
        return run_trial(plan, daemon_source(bench))
