"""A resonance, however narrow, is not an instability; a limit cycle is one. The record decides, not
the window.

Devices are the rigid display of theory with a probe: 8 g, sampled at 1 kHz without delay, passive
up to K = 2 b / T.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from hapticd.model.compose import compose
from hapticd.model.effects import Coulomb, Encoder, Masses, ProbeMass, Saturation, Viscous
from hapticd.model.predict import predicted_impedance
from hapticd.model.scene import Excitation, Scene
from hapticd.zwidth.limits import LimitsParams, plan_limits, run_limits
from hapticd.zwidth.outcomes import Conditions, Outcome, run_trials
from hapticd.zwidth.store import TrialStore
from support.measured_scenes import MOTOR, scene

T = 1e-3
LIMIT = Saturation(limit_n=8.0)
DRY = Coulomb(rotor_n=0.03)
COARSE = Encoder(quantum_m=1e-4)
QUIET = Excitation("noise", psd_n2_per_hz=2.5e-7)
NOISE = Excitation("noise")


def display(viscous: float, *effects, mass_kg: float = 0.008) -> Scene:
    parts = (
        Masses(rotor_kg=mass_kg - 0.003),
        MOTOR,
        ProbeMass(mass_kg=0.003),
        Viscous(rotor_ns_per_m=viscous),
    )
    return scene((*parts, *effects), seconds=90.0)


def least_resistance(device: Scene, stiffness: float) -> float:
    """Return the exact least resistance of the recorded channels, without noise."""
    return predicted_impedance(
        compose(device), (stiffness, 0.0, 0.0), np.linspace(2.0, 500.0, 500)
    ).real.min()


def outcomes(device: Scene, stiffness, seed: int = 1, source: Excitation = NOISE) -> list[Outcome]:
    """Of trials of which no record was kept."""
    points = np.zeros((len(stiffness), 3))
    points[:, 0] = stiffness
    return run_trials(Conditions(device, 90.0, replace(source, seed=seed)), 0.0, points)


def limit_of(viscous: float, tmp_path: Path, seeds: int) -> float:
    """K [N/m] as the search of axis limits finds it."""
    params = LimitsParams(
        Conditions(display(viscous), 90.0, NOISE), levels=(0.0,), axes=(0,), seeds=seeds
    )
    (found,) = run_limits(plan_limits(params), TrialStore(tmp_path / "trials.jsonl")).limits
    return found.value
