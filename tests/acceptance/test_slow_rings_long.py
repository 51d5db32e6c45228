"""What a verdict promises near a slow ring, counted: at most 2 % of the passive environments whose
motion rings for 5 to 60 s are called not passive, and every loop that runs away is.

Rigid devices of 20 to 200 g and 0.05 to 0.5 N s/m, sampled at 1 kHz without delay. Under a spring K
a motion falls by e in 2 m / (b - K T / 2), to first order in T, and the device is passive while
that is positive. The light ones ring for less near that limit, and still do a little beyond it. So
springs under which a motion grows come from the eigenvalues of the sampled loop.

A ring is measured to 5 %, and an undecided trial says what length of record would decide.

A trial is judged in one of two ways. Of many trials, batches keep the spectra and simulate those
again whose records are needed; no model tells them whether the loop is stable. A single trial has
its record, a monitor that may end it, and a model of its device.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import cycle, product
from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import brentq
from support.analysis_resolved import NOISE, T, display, least_resistance, outcomes
from test_slow_rings import spring, verdict

from hapticd.model.compose import compose
from hapticd.model.loop import spectral_radius
from hapticd.model.scene import Scene
from hapticd.signal.resolved import Resolved
from hapticd.signal.verdict import RINGS, Verdict, two_digits
from hapticd.zwidth.simulated import engine_source
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.trial import TrialParams, plan_trial, run_trial

MASSES_KG = (0.02, 0.043, 0.093, 0.2)
VISCOUS_NS_PER_M = (0.05, 0.11, 0.23, 0.5)
RINGS_S = (5.0, 11.0, 26.0, 60.0)
GROWTHS_S = (5.0, 10.0, 20.0, 40.0)  # to e times the motion: it doubles three times in 90 s or more
BATCH_SEEDS = (1, 2, 3, 4)
SINGLE_SEEDS = range(5, 28)  # one after the other
MOST_FALSE = 0.02


def ringing(times_s: Sequence[float]) -> Iterator[tuple[Scene, list[float]]]:
    """Every device, and the springs K > 0 [N/m] under which it rings for these times."""
    for mass_kg, viscous in product(MASSES_KG, VISCOUS_NS_PER_M):
        springs = [(viscous - 2.0 * mass_kg / ring_s) * 2.0 / T for ring_s in times_s]
        yield display(viscous, mass_kg=mass_kg), [one for one in springs if one > 0.0]


def running_away(times_s: Sequence[float]) -> Iterator[tuple[Scene, list[float]]]:
    """Every device, and the springs K [N/m] under which its motion grows by e in these times."""
    for mass_kg, viscous in product(MASSES_KG, VISCOUS_NS_PER_M):
        device = display(viscous, mass_kg=mass_kg)
        limit = 2.0 * viscous / T

        def beyond(stiffness: float, time_s: float, device: Scene = device) -> float:
            return growth_per_s(device, stiffness) - 1.0 / time_s

        yield device, [float(brentq(beyond, limit, 5.0 * limit, (one,))) for one in times_s]


class Single(NamedTuple):
    """A single trial of 90 s."""

    verdict: Verdict
    ring_s: float  # by the sampled loop
    measured_s: float | None  # None where the window was enough


def single(device: Scene, stiffness: float, seed: int) -> Single:
    asked = Trial((stiffness, 0.0, 0.0), excitation=replace(NOISE, seed=seed))
    found = run_trial(plan_trial(TrialParams(asked, device)), engine_source(device))
    measured_s = found.spectra.ring[0] if isinstance(found.spectra, Resolved) else None
    return Single(found.verdict, -1.0 / growth_per_s(device, stiffness), measured_s)


@pytest.fixture(scope="module")
def singles() -> list[Single]:
    """One of every ring."""
    every = [(device, one) for device, springs in ringing(RINGS_S) for one in springs]
    return [single(*one, seed) for one, seed in zip(every, cycle(SINGLE_SEEDS), strict=False)]


def growth_per_s(device: Scene, stiffness: float) -> float:
    """Rate [1/s] at which the motion of the sampled loop grows; of a ring it is negative."""
    radius = spectral_radius(compose(device), np.array([(stiffness, 0.0, 0.0)]))
    return float(np.log(radius[0]) / T)


def assert_few_are_false(answers: Sequence[str]) -> None:
    """Not passive are at most 2 % of these answers to passive environments."""
    counts = Counter(answers)
    undecided = counts["undecided"] / len(answers)
    assert counts["not_passive"] <= MOST_FALSE * len(answers), (
        f"{counts['not_passive']} of {len(answers)} passive environments are called not passive;"
        f" {100.0 * undecided:.1f} % are undecided"
    )


def test_slow_rings_are_stable_and_passive():
    """By the sampled loop, and the exact impedance of the recorded channels."""
    for device, springs in ringing(RINGS_S):
        for stiffness in springs:
            assert growth_per_s(device, stiffness) < -0.99 / max(RINGS_S)
            assert least_resistance(device, stiffness) > 0.0


def test_growing_motions_are_active():
    for device, springs in running_away(GROWTHS_S):
        assert max(least_resistance(device, one) for one in springs) < 0.0


@pytest.mark.slow
def test_batches_call_few_slow_rings_not_passive():
    answers = [
        found.answer
        for (device, springs), seed in product(ringing(RINGS_S), BATCH_SEEDS)
        for found in outcomes(device, springs, seed)
    ]
    assert len(answers) >= 200
    assert_few_are_false(answers)


@pytest.mark.slow
def test_single_trials_call_few_slow_rings_not_passive(singles):
    """The monitor ends none of them as an escape, either."""
    assert_few_are_false([one.verdict.answer for one in singles])


@pytest.mark.slow
def test_ring_is_measured_within_five_percent(singles):
    shares = [one.measured_s / one.ring_s for one in singles if one.measured_s is not None]
    assert len(shares) > 50
    assert 0.95 < min(shares) <= max(shares) < 1.05


@pytest.mark.slow
def test_undecided_single_trial_says_how_long_to_take(singles):
    undecided = [one for one in singles if one.verdict.answer == "undecided"]
    assert len(undecided) >= 3
    for found, ring_s, _ in undecided:
        assert found.seconds_needed > max(90.0, 0.95 * RINGS * ring_s)
        (short,) = (one for one in found.findings if one.code == "short_record")
        assert f"take {two_digits(found.seconds_needed)} s" in short.message


@pytest.mark.slow
def test_batches_find_every_loop_that_runs_away():
    answers = [
        found.answer
        for (device, springs), seed in zip(
            running_away(GROWTHS_S), cycle(BATCH_SEEDS), strict=False
        )
        for found in outcomes(device, springs, seed)
    ]
    assert Counter(answers) == {"not_passive": 64}


@pytest.mark.parametrize(
    ("mass_kg", "viscous", "seed"), [(0.093, 0.11, 4), (0.043, 0.05, 8)], ids=["93 g", "43 g"]
)
def test_record_that_ends_loud_is_undecided_and_says_how_long_to_take(mass_kg, viscous, seed):
    """It has more than 8 rings, but its end explains more of the motion than it should."""
    stiffness = spring(mass_kg, viscous, 11.0)
    found = verdict(display(viscous, mass_kg=mass_kg), stiffness, seed)
    (short,) = (one for one in found.findings if one.code == "short_record")
    assert (found.answer, found.stability) == ("undecided", "stable")
    assert 90.0 < found.seconds_needed < 180.0
    assert "rings for 11 s: the record of 90 s is shorter than" in short.message
    assert short.message.endswith(f"rings; take {two_digits(found.seconds_needed)} s")
