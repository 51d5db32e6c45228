"""A resonance that rings for a good part of its record is not called unstable.

Noise drives the amplitude of a ring as a random walk. Where it rings for a third of the record, the
first seconds are calm because it has hardly begun to ring.
"""

from dataclasses import replace

import pytest
from support.analysis_resolved import NOISE, T, display, outcomes

from hapticd.model.scene import Scene
from hapticd.signal.resolved import Resolved
from hapticd.signal.verdict import Verdict
from hapticd.zwidth.simulated import engine_source
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.trial import TrialParams, TrialResult, plan_trial, run_trial

HEAVY = display(0.1, mass_kg=0.1)
HEAVY_LIMIT = 2.0 * 0.1 / T


def trial(device: Scene, stiffness: float, seed: int, known: bool = False) -> TrialResult:
    """A trial of 90 s; `known`: its predicted radius is known to the verdict."""
    asked = Trial((stiffness, 0.0, 0.0), excitation=replace(NOISE, seed=seed))
    plan = plan_trial(TrialParams(asked, device if known else None))
    return run_trial(plan, engine_source(device))


def spring(mass_kg: float, viscous: float, ring_s: float) -> float:
    """K [N/m] under which a device rings for that time."""
    return (viscous - 2.0 * mass_kg / ring_s) * 2.0 / T


def verdict(device: Scene, stiffness: float, seed: int, known: bool = False) -> Verdict:
    return trial(device, stiffness, seed, known).verdict


@pytest.mark.parametrize("seed", [1, 2, 4, 9, 10])
def test_ring_of_a_third_of_the_record_does_not_end_its_trial(seed):
    found = trial(HEAVY, 0.94 * HEAVY_LIMIT, seed, known=True)
    assert found.recorded.ended is None
    assert (found.verdict.stability, found.verdict.seconds) == ("stable", 90.0)
    assert found.verdict.answer != "not_passive"


def test_record_of_few_rings_leaves_it_undecided_and_says_how_long_to_take():
    ring_s = 35.0
    viscous = 2.0 * 0.1 / (ring_s * 0.06)
    found = verdict(display(viscous, mass_kg=0.1), 0.94 * 2.0 * viscous / T, 4)
    (short,) = (one for one in found.findings if one.code == "short_record")
    assert found.answer == "undecided"
    assert "rings for 35 s: the record of 90 s is shorter than 8 rings; take 280 s" in short.message
    assert found.seconds_needed == pytest.approx(8.0 * ring_s, rel=0.02)


@pytest.mark.parametrize(
    ("mass_kg", "viscous", "ring_s"),
    [(0.2, 0.05, 11.0), (0.093, 0.05, 11.0), (0.2, 0.11, 60.0), (0.02, 0.05, 26.0)],
    ids=["1.9 Hz", "4.2 Hz", "5.1 Hz", "11 Hz"],
)
def test_ring_is_measured_wherever_its_resonance_lies(mass_kg, viscous, ring_s):
    """The lines of the window are 1 Hz apart, and the lowest is beside the resonance."""
    found = trial(
        display(viscous, mass_kg=mass_kg), spring(mass_kg, viscous, ring_s), seed=1, known=True
    )
    assert isinstance(found.spectra, Resolved)
    assert found.spectra.ring[0] == pytest.approx(ring_s, rel=0.03)


@pytest.mark.parametrize("seed", [1, 2])
def test_loop_that_runs_away_more_slowly_than_its_record_shows_is_found_by_its_resistance(seed):
    """It grows by e in 330 s."""
    assert verdict(HEAVY, 1.006 * HEAVY_LIMIT, seed).answer == "not_passive"


@pytest.mark.parametrize("seed", range(1, 5))
def test_many_trials_call_no_resonance_an_oscillation(seed):
    """Its peak is narrower than the window by far, so the window sees no coherence in it."""
    ring_s = 60.0
    viscous = 2.0 * 0.008 / (ring_s * 0.015)
    (found,) = outcomes(display(viscous), [0.985 * 2.0 * viscous / T], seed)
    assert (found.answer, found.passes) == ("passive", True)
