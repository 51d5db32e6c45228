"""One trial with the whole stack in lock-step, beside the engine."""

import numpy as np

from hapticd.run.lockstep import run_lockstep
from hapticd.settings.scene import load_scene
from hapticd.studies.accuracy import phase_rms
from hapticd.studies.effects import spectra_on
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.sources import frequencies


def test_trial_has_the_impedance_of_the_engine() -> None:
    """Same forces, same counts: the two spectra differ by the rounding of the record alone."""
    theory = load_scene("theory")
    f = frequencies()
    force = np.random.default_rng(2).normal(0.0, 0.2, 24_000)
    trial = run_lockstep("theory", force, [(0.0, 0.0)])
    like = simulate(theory, [(1000.0, 0.0, 0.0)], 6.0, excitation=trial.torque_n, keep="records")
    one = spectra_on(trial.torque_n, trial.velocity_m_per_s, f)
    other = spectra_on(*like.record(0), f)
    assert phase_rms((one.cross / one.velocity) / (other.cross / other.velocity)) < 0.2
