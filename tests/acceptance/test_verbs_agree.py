"""One answer from every verb: the same point, noise, length and band give the same verdict."""

from dataclasses import replace

import numpy as np
import pytest

from examples.weir2008 import run
from examples.weir2008.paper import HIGH_PASS
from hapticd.settings.scene import load_scene
from hapticd.zwidth import search
from hapticd.zwidth.limits import LimitsParams, plan_limits, run_limits
from hapticd.zwidth.map import MapParams, plan_map, run_map
from hapticd.zwidth.outcomes import Conditions, run_trials
from hapticd.zwidth.simulated import engine_source
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.store import TrialStore
from hapticd.zwidth.trial import TrialParams, plan_trial, run_trial

SCENE = "fig7"
LEVEL = 1.74
SEED = 3
SECONDS = 20.0
FIRST_LINE_HZ = 3.0 * 4000.0 / 4096.0  # of the window, inside a band from 2 Hz
ALONE = 1.0  # a tolerance that ends a search of a limit after its first round


def given(dtype):
    """Conditions of all verbs."""
    scene = load_scene(SCENE)
    return Conditions(scene, SECONDS, replace(scene.noise, seed=SEED), dtype=dtype)


def by_trial(point, seed):
    """The verdict of `zwidth trial`."""
    asked = given("f64").perturbed(more_seed=seed - SEED)
    trial = Trial(point, LEVEL, SECONDS, asked.excitation)
    plan = plan_trial(TrialParams(trial, asked.scene))
    return run_trial(plan, engine_source(asked.scene)).verdict


def by_limits(point, asked):
    """Its outcome in `zwidth limits`, whose scan of K begins there."""
    heard = {}

    def hear(scan, conditions, new):
        heard.update({outcome.environment: outcome for outcome in new})

    params = LimitsParams(asked, (LEVEL,), axes=(0,), base=point, tolerance=ALONE)
    run_limits(plan_limits(params), TrialStore(None), on_outcomes=hear)
    return heard[point]


def by_map(point, asked):
    """Its outcome in `zwidth map`: the grid's other points are far off, so it lies at the edge
    of the set.
    """
    axes = tuple(
        np.array([value, value + far]) for value, far in zip(point, (4e3, 40.0, 0.2), strict=True)
    )
    result = run_map(plan_map(MapParams(asked, axes, (LEVEL,))), TrialStore(None))
    return next(one for one in result.levels[0].outcomes if one.environment == point)


@pytest.fixture(scope="module")
def searched():
    """The first trials of `zwidth search`, which chooses its points: each with noise of its own."""
    params = search.SearchParams(given("f64"), LEVEL, budget=4)
    found = search.run_search(search.plan_search(params), TrialStore(None))
    return [step.outcome for step in found.steps]


def told(outcome):
    """What an outcome says."""
    margins = (
        outcome.margin_ns_per_m,
        outcome.margin_lower,
        outcome.margin_upper,
        outcome.margin_deg,
    )
    return margins, (outcome.worst_hz, outcome.first_judged_hz, outcome.last_judged_hz)


def told_of(verdict):
    """What a verdict says of the same."""
    newton = verdict.margin_ns_per_m
    margins = (newton.value, newton.lower, newton.upper, verdict.margin_deg.value)
    return margins, (newton.frequency_hz, verdict.first_judged_hz, verdict.last_judged_hz)


@pytest.fixture
def short_trials(monkeypatch):
    """The reproduction makes trials of SECONDS; its conditions are kept, so what others asked is
    forgotten.
    """
    monkeypatch.setattr(run, "SECONDS", SECONDS)
    run.conditions.cache_clear()
    yield
    run.conditions.cache_clear()


@pytest.mark.usefixtures("short_trials")
def test_every_verb_gives_the_margin_of_the_trial(searched):
    """At a stiffness whose least Re Z is at the lower edge: with the window's lines alone it
    would be another.
    """
    outcome = searched[1]
    seed = SEED + 1
    point = outcome.environment
    asked = given("f64").perturbed(more_seed=1)
    margins, places = told_of(by_trial(point, seed))
    assert places == (2.0, 2.0, 500.0)
    shown = run.single_trial(run.MAIN, point, LEVEL, seed)
    found = [
        told(outcome),
        told(by_limits(point, asked)),
        told(by_map(point, asked)),
        told_of(shown.verdict),
    ]
    for of_verb, where in found:
        assert of_verb == pytest.approx(margins, rel=1e-9)
        assert where == places


def test_every_trial_of_a_search_is_judged_as_one_alone(searched):
    for more, outcome in enumerate(searched):
        margins, places = told_of(by_trial(outcome.environment, SEED + more))
        assert told(outcome)[0] == pytest.approx(margins, rel=1e-9)
        assert told(outcome)[1] == places


def test_fused_float32_gives_the_margin_to_its_digits(searched):
    """To 1e-5 of |Z|: what float32 rounds, it rounds of that.

    Without a command: one that is rounded across a count, or friction that then sticks a sub-step
    earlier, makes another motion, 2e-5 of |Z| away in most trials and 1e-3 in some.
    """
    point = searched[0].environment
    (fused,) = run_trials(given("f32"), LEVEL, np.array([point]))
    exact = by_trial(point, SEED)
    size = np.hypot(*fused.z[np.searchsorted(fused.frequency_hz, 2.0)])
    assert told(fused)[1] == told_of(exact)[1]
    assert fused.margin_ns_per_m == pytest.approx(exact.margin_ns_per_m.value, abs=1e-5 * size)
    assert fused.answer == exact.answer


@pytest.mark.usefixtures("short_trials")
def test_limits_and_the_reproduction_find_the_same_limit_of_every_noise():
    """Of the device whose least Re Z is at the lower edge: on the window's lines alone, from
    2.93 Hz on, the limit would be another."""
    own = run.conditions(HIGH_PASS)
    scene = load_scene(run.SCENES[HIGH_PASS])
    asked = Conditions(scene, SECONDS, replace(scene.noise, seed=own.excitation.seed))
    searched = {"levels": (LEVEL,), "axes": (0,), "seeds": 2}
    limit, elsewhere = (
        run_limits(plan_limits(LimitsParams(one, **searched)), TrialStore(None)).limits[0]
        for one in (asked, replace(asked, band_hz=(FIRST_LINE_HZ, 500.0)))
    )
    plan = plan_limits(LimitsParams(own, **searched, tolerance=run.FINE))
    (reproduced,) = run.limits_of([plan], TrialStore(None))
    tolerance = LimitsParams(asked).tolerance
    assert limit.values == pytest.approx(reproduced.values.tolist(), rel=tolerance)
    assert elsewhere.values[1] > (1.0 + 10.0 * tolerance) * limit.values[1]
