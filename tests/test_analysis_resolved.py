"""A resonance is no instability, however narrow; a limit cycle is one. What decides is the record, not the window.

Devices are the rigid display of theory with a probe: 8 g, sampled at 1 kHz without delay, passive up to K = 2 b / T.
"""

import numpy as np
import pytest
from measured_scenes import MOTOR, scene

from hapticd.analysis.predict import predicted_impedance
from hapticd.analysis.verdict import Verdict
from hapticd.measure.outcomes import Conditions, Outcome, fly
from hapticd.measure.recorded import Recorded
from hapticd.measure.sources import Trial
from hapticd.measure.trial import TrialParams, judged, plan_trial
from hapticd.plant.bodies import Masses, Probe, Viscous
from hapticd.plant.compose import compose
from hapticd.plant.electrical import Saturation
from hapticd.plant.friction import Coulomb
from hapticd.plant.scene import Excitation, Scene
from hapticd.plant.sensing import Encoder
from hapticd.sim.engine import simulate

T = 1e-3
LIMIT = Saturation(limit_n=8.0)
DRY = Coulomb(rotor_n=0.03)
COARSE = Encoder(quantum_m=1e-4)
QUIET = Excitation("noise", psd_n2_per_hz=2.5e-7)
NOISE = Excitation("noise")


def display(viscous: float, *effects, mass_kg: float = 0.008) -> Scene:
    parts = (Masses(rotor_kg=mass_kg - 0.003), MOTOR, Probe(mass_kg=0.003), Viscous(rotor_ns_per_m=viscous))
    return scene((*parts, *effects), seconds=90.0)


def least_resistance(device: Scene, stiffness: float) -> float:
    """The exact one of the recorded channels, without noise."""
    return predicted_impedance(compose(device), (stiffness, 0.0, 0.0), np.linspace(2.0, 500.0, 500)).real.min()


def verdict(device: Scene, stiffness: float, seed: int, source: Excitation = NOISE) -> Verdict:
    """Of a trial whose record was kept."""
    found = simulate(device, [[stiffness, 0.0, 0.0]], 90.0, seed, excitation=source, start=(0.0, 0.0), keep="records")
    force, velocity = (np.asarray(channel, np.float64) for channel in found.record(0))
    plan = plan_trial(TrialParams(Trial((stiffness, 0.0, 0.0), seconds=90.0), device))
    return judged(plan, Recorded(force, velocity, found.rate_hz, "engine", True)).verdict


def outcomes(device: Scene, stiffness, seed: int = 1) -> list[Outcome]:
    """Of trials of which no record was kept."""
    points = np.zeros((len(stiffness), 3))
    points[:, 0] = stiffness
    return fly(Conditions(device, 90.0, Excitation("noise", seed=seed)), 0.0, points)


def codes(found: Verdict) -> list[str]:
    return [one.code for one in found.findings]


@pytest.mark.parametrize("viscous", [0.12, 0.3, 1.0])
@pytest.mark.parametrize("share", [0.5, 0.83, 0.97])
def test_display_inside_its_limit_is_passive_by_its_true_margin(viscous, share):
    device, stiffness = display(viscous), share * 2.0 * viscous / T
    (found,) = outcomes(device, [stiffness])
    assert found.answer == "passive"
    assert found.passes
    assert found.margin_lower <= least_resistance(device, stiffness) <= found.margin_upper
    assert found.margin_upper - found.margin_lower < 0.01 * viscous


@pytest.mark.parametrize("stiffness", [100.0, 300.0, 600.0])
def test_resonance_of_the_device_is_no_line(stiffness):
    found = verdict(display(1.0, mass_kg=0.023), stiffness, 1)
    assert found.answer == "passive"
    assert not {"line", "oscillation", "unresolved"} & set(codes(found))


def test_verdict_says_how_and_where_it_was_judged_again():
    found = verdict(display(0.12), 200.0, 1)
    assert "stable, spectral radius 0.998" in str(found)
    assert "leakage: |Z| reads about" in str(found)
    assert (
        "motion narrower than the window of 2048 samples: judged again by the record's own frequencies, 0.011 Hz apart, by local "
        "polynomials 5.9 Hz wide from 1.95 to 500 Hz"
    ) in str(found)


@pytest.mark.parametrize(
    ("device", "stiffness", "source"),
    [
        (display(0.12, DRY, LIMIT), 600.0, NOISE),
        (display(0.3, LIMIT), 620.0, NOISE),
        (display(0.3, COARSE, LIMIT), 580.0, QUIET),
    ],
    ids=["friction and too much stiffness", "escape to the limit", "counts"],
)
def test_limit_cycle_is_an_oscillation(device, stiffness, source):
    found = verdict(device, stiffness, 1, source)
    assert (found.answer, found.stability) == ("not_passive", "unstable")
    assert "oscillation" in codes(found)
