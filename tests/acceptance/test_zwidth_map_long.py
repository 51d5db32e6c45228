"""Many trials on the simulator: axis limits, maps, the directed search, virtual walls, portable
summaries.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.zwidth_map import conditions
from test_zwidth_map import AXES

from hapticd.core.errors import AnalysisError
from hapticd.settings.scene import load_scene
from hapticd.zwidth.acquisition import first_trials, predicted_passive
from hapticd.zwidth.limits import LimitsParams, plan_limits, run_limits
from hapticd.zwidth.map import MapParams, kept_map, plan_map, run_map
from hapticd.zwidth.outcomes import (
    Conditions,
    TrialBatch,
    restored,
    run_trials,
)
from hapticd.zwidth.passive_set import PassiveSet, grid
from hapticd.zwidth.search import SearchParams, plan_search, rounded, run_search, slice_at
from hapticd.zwidth.store import TrialStore
from hapticd.zwidth.surrogate import Box


def test_axis_limits_are_those_of_sampled_data_theory():
    """b = 1 N s/m, T = 1 ms, no delay (Colgate and Schenkel 1997): K < 2 b / T; B < 2.184 b by the
    first harmonic.

    A spring leaves almost no velocity at 2 Hz, so its limit is found too low by leakage, never too
    high.
    """
    plan = plan_limits(LimitsParams(conditions(seconds=90.0), levels=(0.0,)))
    stiffness, damping, mass = run_limits(plan, TrialStore(None)).limits
    assert stiffness.scan.predicted == pytest.approx(2000.0, rel=0.02)
    assert damping.scan.predicted == pytest.approx(2.184, rel=0.02)
    assert 1500.0 < stiffness.value < 2040.0
    assert damping.value == pytest.approx(damping.scan.predicted, rel=0.03)
    assert mass.value == pytest.approx(mass.scan.predicted, rel=0.03)
    for limit in (damping, mass):
        assert abs(limit.lower) <= abs(limit.value)
        assert limit.upper != limit.upper or abs(limit.upper) >= abs(limit.value)


def test_search_needs_few_trials_on_a_rigid_display():
    """Affine, by theory: after 12 noisy trials the yes and no of 600 environments is that of
    the prediction in 97 %.
    """
    box = Box((0.0, 0.0, -0.006), (4000.0, 3.0, 0.008))
    plan = plan_search(SearchParams(conditions(seconds=30.0), 0.0, budget=12, box=box))
    store = TrialStore(None)
    result = run_search(plan, store)
    assert len(result.steps) <= 12
    assert len(store.known) == len(result.steps)
    truth = plan_map(
        MapParams(
            conditions(),
            (np.linspace(0, 4000, 12), np.linspace(0, 3, 7), np.linspace(-0.006, 0.008, 7)),
            (0.0,),
        )
    )
    points = grid(truth.params.axes)
    held = predicted_passive(result.search, points)
    assert np.mean(held == truth.levels[0].prediction.passive) > 0.97
    again = run_search(plan, store)
    assert len(store.known) == len(result.steps)
    assert [step.outcome.environment for step in again.steps] == [
        step.outcome.environment for step in result.steps
    ]


def test_slice_of_a_search_ends_where_theory_says():
    """b = 1 N s/m, T = 1 ms: K < 2 b / T and B < 2.184 b by prediction; the strict rule asks a
    little more of noisy trials.
    """
    box = Box((0.0, 0.0, -0.006), (4000.0, 3.0, 0.008))
    result = run_search(
        plan_search(SearchParams(conditions(), 0.0, budget=16, box=box)), TrialStore(None)
    )
    cut = slice_at(result, 0.0)
    assert cut.predicted[0] == pytest.approx(2000.0, rel=0.02)
    assert 1500.0 < cut.held[0] < 2040.0
    ends = [cut.virtual_damping[np.isfinite(edge)][-1] for edge in (cut.predicted, cut.held)]
    assert ends == pytest.approx([2.184, 2.184], rel=0.04)
    assert np.isnan(cut.held[cut.virtual_damping > 1.04 * 2.184]).all()


def test_trials_of_a_search_have_noise_of_their_own():
    box = Box((0.0, 0.0, -0.006), (4000.0, 3.0, 0.008))
    store = TrialStore(None)
    heard = []
    plan = plan_search(SearchParams(conditions(), 0.0, budget=6, box=box))
    result = run_search(plan, store, on_outcomes=heard.extend)
    assert [outcome.environment for outcome in heard] == [
        step.outcome.environment for step in result.steps
    ]
    third = result.steps[2].outcome
    other = replace(
        conditions(),
        excitation=replace(conditions().excitation, seed=conditions().excitation.seed + 2),
    )
    (key,) = TrialBatch(
        other, 0.0, (tuple(rounded(first_trials(box, np.zeros(3)))[2]),)
    ).keys.values()
    assert np.array_equal(restored(store.known[key]).z, third.z)
    assert not np.array_equal(
        third.z, run_trials(conditions(), 0.0, np.array([third.environment]))[0].z
    )


@pytest.mark.slow
def test_search_beats_the_prediction_that_it_began_from():
    """Damped weir2008: 20 trials of 90 s against a coarse grid of them with noise of other
    seeds.
    """
    scene = load_scene("fig4")
    calibrated = Conditions(scene, 90.0, scene.noise)
    plan = plan_search(SearchParams(calibrated, 1.74, budget=20, doubt=0.0))
    result = run_search(plan, TrialStore(None))
    axes = (np.linspace(0.0, 1400.0, 8), np.linspace(0.0, 10.0, 8), np.linspace(-0.028, 0.04, 8))
    other = replace(calibrated, excitation=replace(calibrated.excitation, seed=901))
    whole = plan_map(MapParams(other, axes, (1.74,), everywhere=True))
    (level,) = run_map(whole, TrialStore(None)).levels
    truth = level.found.passive.ravel()
    before = np.count_nonzero(whole.levels[0].prediction.passive != truth)
    after = np.count_nonzero(predicted_passive(result.search, grid(axes)) != truth)
    assert after <= 0.6 * before
    assert after <= 0.08 * np.count_nonzero(truth)
    escaped = [step.outcome.environment for step in result.steps if not step.teaches]
    assert escaped
    assert not any(tuple(trial.environment) in escaped for trial in result.search.trials)


def test_friction_makes_limits_fall_with_amplitude():
    """Most of the undamped display's damping is Coulomb friction, which counts for less the
    more it moves (physics, 11b).
    """
    scene = load_scene("fig4")
    plan = plan_limits(
        LimitsParams(conditions(scene), levels=(0.0,), amplitudes=(1.0, 4.0), axes=(1,))
    )
    low, high = run_limits(plan, TrialStore(None)).limits
    assert high.value < 0.8 * low.value
    assert high.perturbation_psd == pytest.approx(16 * low.perturbation_psd)


@pytest.mark.parametrize(
    "more", [{}, {"everywhere": True}, {"refine": 1}], ids=["near", "everywhere", "refined"]
)
def test_map_of_its_kept_trials_is_the_map_that_was_flown(tmp_path, more):
    """Also those far from the boundary, simulated with one sub-step, and those of a finer grid."""
    axes = (np.linspace(0.0, 3000.0, 3), np.linspace(0.0, 3.0, 3), np.array([-0.004, 0.0]))
    plan, path = (
        plan_map(MapParams(conditions(), axes, (0.0, 1.74), **more)),
        tmp_path / "trials.jsonl",
    )
    flown, kept = run_map(plan, TrialStore(path)), kept_map(plan, TrialStore(path))
    assert kept.made == 0
    assert kept.judged == flown.judged
    for ours, theirs in zip(kept.levels, flown.levels, strict=True):
        assert np.array_equal(ours.found.margin, theirs.found.margin, equal_nan=True)
        assert np.array_equal(ours.tried, theirs.tried)
        assert ours.disagreements == theirs.disagreements


def test_map_tries_only_near_the_predicted_boundary_and_agrees_there():
    plan = plan_map(MapParams(conditions(), AXES, (0.0,)))
    assert 0 < plan.trials < 96
    (level,) = run_map(plan, TrialStore(None)).levels
    assert int(level.tried.sum()) == plan.trials
    assert level.disagreements <= 0.15 * plan.trials
    predicted = PassiveSet.of(AXES, plan.levels[0].prediction.decided_margin)
    assert level.found.limits().virtual_damping == predicted.limits().virtual_damping
    everywhere = plan_map(MapParams(conditions(), AXES, (0.0,), everywhere=True))
    assert everywhere.trials == 96
    (full,) = run_map(everywhere, TrialStore(None)).levels
    assert np.mean(full.found.passive == level.found.passive) > 0.97


def test_refinement_halves_the_grid_at_the_boundary():
    """At K = M = 0 the set ends at B = 2.18 N s/m: between 1.5 and 3 there is one more trial,
    and it fails.
    """
    axes = (np.array([0.0, 100.0]), np.array([0.0, 1.5, 3.0]), np.array([0.0, 0.0005]))
    coarse = plan_map(MapParams(conditions(seconds=60.0), axes, (0.0,), everywhere=True))
    finer = replace(coarse, params=replace(coarse.params, refine=1))
    (level,) = run_map(finer, TrialStore(None)).levels
    on_grid = {tuple(point) for point in coarse.levels[0].prediction.points.tolist()}
    added = {
        outcome.environment: outcome.passes
        for outcome in level.outcomes
        if outcome.environment not in on_grid
    }
    assert added[(0.0, 2.25, 0.0)] is False
    assert all(b == 2.25 for _, b, _ in added)
    assert level.found.axes[1].tolist() == [0.0, 0.75, 1.5, 2.25, 3.0]
    told = {outcome.environment: outcome.margin_ns_per_m for outcome in level.outcomes}
    assert level.found.margin[0, 3, 0] == -abs(
        told[0.0, 2.25, 0.0]
    )  # between a pass and a failure: the trial's
    assert level.found.passive[0, 1, 0]  # between two passes
    assert int(level.tried.sum()) == len(level.outcomes)


def test_search_beside_an_active_display_says_so():
    plan = plan_search(
        SearchParams(conditions(), 0.0, box=Box((0.0, -9.0, -0.001), (4000.0, 0.01, 0.001)))
    )
    with pytest.raises(AnalysisError, match=r"next to K = B = M = 0 was not stable"):
        run_search(plan, TrialStore(None))


@pytest.mark.parametrize("level", [0.0, 1.74])
def test_box_of_a_search_holds_the_predicted_set(level):
    """At 1.6 times the negative limit of M the ideal display is still passive."""
    plan = plan_search(SearchParams(conditions(), level))
    sides = [np.linspace(*ends, 12) for ends in zip(plan.box.low, plan.box.high, strict=True)]
    predicted = conditions().display.predicted(grid(sides), level)
    assert PassiveSet.of(sides, predicted.decided_margin).open_ends() == ("B min",)


def test_set_that_goes_on_beyond_the_box_is_marked_open():
    box = Box((0.0, 0.0, -0.006), (400.0, 3.0, 0.003))
    params = SearchParams(conditions(seconds=10.0), 0.0, budget=4, box=box)
    found = run_search(plan_search(params), TrialStore(None))
    assert found.plan.box == box
    assert found.open_ends == ("K max", "B min", "M max")


def test_midpoint_that_passes_moves_the_limit():
    """At K = M = 0 the set ends at B = 2.18 N s/m: the midpoint of 1 and 3 passes."""
    axes = (np.array([0.0, 100.0]), np.array([0.0, 1.0, 3.0]), np.array([0.0, 0.0005]))
    coarse = plan_map(MapParams(conditions(seconds=60.0), axes, (0.0,), everywhere=True))
    finer = replace(coarse, params=replace(coarse.params, refine=1))
    store = TrialStore(None)
    limits = [
        run_map(plan, store).levels[0].found.limits().virtual_damping[1] for plan in (coarse, finer)
    ]
    assert limits == [1.0, 2.0]
