"""The directed search on oracles whose boundary is known: how many trials it needs, with and
without noise and a prior.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from support.analysis_search import (
    BOX,
    INSIDE,
    SAMPLES,
    Oracle,
    W,
    directed_search,
    error,
)

from hapticd.core.errors import AnalysisError
from hapticd.zwidth.acquisition import (
    Search,
    first_trials,
    least_headroom,
    next_trials,
)
from hapticd.zwidth.passive_set import boundary
from hapticd.zwidth.surrogate import Observation, fit, log_chance, margin, resistance


def test_passive_set_fills_a_fifth_of_the_box():
    assert Oracle().passive(SAMPLES).mean() == pytest.approx(0.19, abs=0.01)


def test_affine_device_is_known_after_four_trials():
    oracle = Oracle()
    found = directed_search(oracle, Search(BOX), INSIDE, budget=4)
    assert oracle.asked == 4
    assert error(found, oracle) < 1e-3


def test_affine_device_within_ten_trials_at_two_percent():
    oracle = Oracle()
    found = directed_search(oracle, Search(BOX), INSIDE, budget=10, doubt=0.01)
    assert oracle.asked <= 10
    assert error(found, oracle) <= 0.02


def test_next_trial_lies_on_the_predicted_boundary():
    search = directed_search(Oracle(bend=1.0), Search(BOX), INSIDE, budget=12)
    environment = next_trials(search)[0]
    level = margin(search.surrogate, environment)[0]
    at_end = np.isclose(np.abs(BOX.to_unit(environment) - 0.5).max(), 0.5, atol=0.002)
    assert at_end or abs(level) < 0.02
    nearest = np.linalg.norm(
        BOX.to_unit([one.environment for one in search.trials]) - BOX.to_unit(environment), axis=1
    ).min()
    assert nearest > 0.1


def test_several_trials_at_once_are_apart():
    search = directed_search(Oracle(bend=1.0), Search(BOX), INSIDE, budget=8)
    unit = BOX.to_unit(next_trials(search, 5))
    gaps = [np.linalg.norm(unit[i] - unit[j]) for i in range(5) for j in range(i)]
    assert min(gaps) > 0.1
    assert np.array_equal(next_trials(search, 1)[0], next_trials(search, 5)[0])


def test_stability_narrows_the_set():
    search = directed_search(Oracle(), Search(BOX), INSIDE, budget=5)
    points = next_trials(
        replace(search, headroom=lambda environments: 400.0 - environments[:, 0]), 20
    )
    assert points[:, 0].max() == pytest.approx(400.0, abs=2.0)
    assert next_trials(search, 20)[:, 0].max() > 800.0


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (
            lambda: first_trials(BOX, (2000.0, 0.0, 0.0)),
            "the first environment [2000.0, 0.0, 0.0] lies outside the box",
        ),
        (
            lambda: next_trials(Search(BOX)),
            "0 stable trials so far: four are needed before the search can direct",
        ),
        (
            lambda: fit(BOX, [Oracle()(np.array(INSIDE))] * 3),
            "3 trials: at least four with spectra on the same frequencies",
        ),
        (
            lambda: fit(BOX, [Oracle()(np.array(INSIDE))] * 4),
            "the first trials lie in a plane: vary K, B and M each",
        ),
    ],
)
def test_search_without_ground_is_refused(action, message):
    with pytest.raises(AnalysisError, match=re.escape(message)):
        action()


def test_first_trials_step_along_each_axis():
    unit = BOX.to_unit(first_trials(BOX, (1400.0, 0.0, 0.0)))
    steps = unit[1:] - unit[0]
    assert np.count_nonzero(np.abs(steps) > 1e-12) == 3
    assert steps[0, 0] < 0.0
    assert ((unit >= 0) & (unit <= 1)).all()


def test_exact_prior_leaves_nothing_to_learn():
    oracle = Oracle(bend=1.0)
    found = directed_search(oracle, Search(BOX, oracle.exact), INSIDE, budget=6)
    assert np.allclose(
        resistance(found.surrogate, SAMPLES[:50]), oracle.exact(SAMPLES[:50]), atol=1e-9
    )
    assert error(found, oracle) < 1e-3


def test_chance_of_a_yes_is_that_of_noisy_trials():
    """Independent noise on 20 frequencies, counted over 400 trials of each environment."""
    f = np.arange(0, W.size, 15)
    points = BOX.to_environment(np.random.default_rng(5).random((400, 3)))
    sd = np.full(f.size, 0.05)
    random = np.random.default_rng(6)
    trials = [Observation(point, Oracle().exact(point)[0, f], sd) for point in points[:40]]
    found = fit(BOX, trials, lambda environments: Oracle().exact(environments)[:, f])
    yes = np.zeros(len(points))
    for _ in range(400):
        yes += (
            Oracle().exact(points)[:, f] + sd * random.standard_normal((len(points), f.size)) >= 0.0
        ).all(axis=1) / 400
    chance = np.exp(log_chance(found, points, np.ones(f.size)))
    assert np.abs(chance - yes).max() < 0.1
    assert np.count_nonzero((yes > 0.1) & (yes < 0.9)) > 10
    counted_twice = np.exp(log_chance(found, points, 2.0 * np.ones(f.size)))
    assert np.allclose(counted_twice, chance**2)


def test_without_noise_a_trial_says_what_is_expected():
    found = directed_search(Oracle(), Search(BOX), INSIDE, budget=5).surrogate
    chance = log_chance(found, SAMPLES[:100], np.ones(W.size))
    assert np.array_equal(chance == 0.0, margin(found, SAMPLES[:100]) >= 0.0)


def test_least_headroom_lies_between_stable_and_unstable_trials():
    assert least_headroom(np.empty(0), np.empty(0, bool)) == pytest.approx(0.0, abs=1e-9)
    values = np.array([-0.4, -0.2, 0.1, 0.14, 0.3])
    found = least_headroom(values, values > 0.12)
    assert 0.1 < found < 0.14
    assert least_headroom(values, values > -1.0) < -0.3
    assert least_headroom(values, values > 1.0) > 0.3


def test_contradicting_trials_are_weighed_by_their_number():
    """At one headroom where chance decides: mostly unstable means that the boundary lies above
    it, and the other way round.
    """
    values = np.repeat([0.0, 0.2, 0.4], 10)
    few, many = (
        np.concatenate((np.zeros(10), np.arange(10) < stable, np.ones(10))) > 0.5
        for stable in (2, 8)
    )
    assert least_headroom(values, few) > 0.2 > least_headroom(values, many)


def test_rays_leave_a_ball_at_its_surface():
    centre = np.array([0.5, 0.4, 0.5])
    points, ends = boundary(lambda unit: np.linalg.norm(unit - centre, axis=1) < 0.3, centre)
    assert np.allclose(np.linalg.norm(points - centre, axis=1), 0.3, atol=1e-3)
    assert not ends.any()
    points, ends = boundary(lambda unit: unit[:, 0] < 0.7, centre)
    assert ends.any()
    assert (np.abs(points[ends] - 0.5).max(axis=1) > 0.49).all()
    assert np.allclose(points[~ends, 0], 0.7, atol=1e-3)
