"""Beyond the paper: closed forms on a rigid device, the striking-out of failed owners, and what
every row and point must keep.
"""

from dataclasses import replace
from math import log

import numpy as np
import pytest
from support.measured_scenes import DRY, scene
from support.reproduced import future_work_by_prediction

from examples.weir2008 import future_work
from examples.weir2008.future_work import (
    GRID,
    LOW_HZ,
    Bench,
    Case,
    bounds_of,
    candidates,
    damping_levels,
    free_motion,
    lightest_safe,
    mean_db,
    mean_sd,
    passing_twice,
    plan_future_work,
    run_future_work,
    shown_hz,
    sizes,
)
from examples.weir2008.paper import paper_equation_2
from examples.weir2008.run import AXES, FINE
from hapticd.core.errors import AnalysisError
from hapticd.model.effects import Masses, Motor, Viscous
from hapticd.model.predict import predict
from hapticd.model.step import held_force_response
from hapticd.model.theorem import lifted_margin, lifted_system
from hapticd.zwidth import outcomes
from hapticd.zwidth.limits import REACH
from hapticd.zwidth.outcomes import Conditions, Outcome, kept_frequencies

MASS_KG = 0.008
VISCOUS = 0.4
LEVEL = 1.5
PARTS_OF_RIGID = (
    Masses(rotor_kg=MASS_KG),
    Motor(torque_constant_nm_per_a=0.0165, lever_m=0.01, resistance_ohm=1.6),
    Viscous(rotor_ns_per_m=VISCOUS),
)
ORIGIN = np.zeros((1, 3))
SMALL = GRID[(GRID[:, 0] <= 100.0) & (GRID[:, 2] % 0.006 < 1e-9)]


def bench(effects, **more):
    own = scene(effects, **more)
    return Bench(Conditions(own, 90.0, own.excitation))


def made_up(given, level, points):
    """Trials that pass down to B = -1 N s/m."""
    nothing = np.empty(0)
    return [
        Outcome(
            tuple(point),
            level,
            "passive",
            bool(point[1] >= -1.0),
            0.1,
            0.05,
            0.2,
            1.0,
            3.0,
            0.02,
            1.0,
            nothing,
            nothing,
        )
        for point in points.tolist()
    ]


@pytest.fixture(scope="module")
def rigid():
    """No friction, no lags: everything is known in closed form."""
    return bench(PARTS_OF_RIGID)


@pytest.fixture(scope="module")
def quick():
    """All of it by prediction, with fewer corners."""
    return future_work_by_prediction()


def test_mean_over_ln_f_of_a_slope_is_that_in_the_middle():
    f = np.geomspace(2.0, 20.0, 7)
    middle = np.exp(0.5 * (log(2.0) + log(20.0)))
    assert mean_db(f, (3.0 * f)[None], LOW_HZ)[0] == pytest.approx(
        20 * np.log10(3.0 * middle), rel=1e-12
    )
    assert mean_db(f, np.full((2, 7), 10.0), LOW_HZ).tolist() == pytest.approx([20.0, 20.0])


def mean_velocity(turn, damping):
    """Of a mass, over an interval in which a force of 1 N is held, at z = `turn`."""
    decay, push, reach, shove = held_force_response(MASS_KG, damping, 1.0 / 4000.0)
    return 4000.0 * (reach * push / (turn - decay) + shove)


@pytest.mark.parametrize("level", [0.0, LEVEL])
def test_impedance_of_a_rigid_device_is_mass_and_damping(rigid, level):
    f = shown_hz()
    expected = 1.0 / mean_velocity(np.exp(2j * np.pi * f / 4000.0), VISCOUS + level)
    assert rigid.display.impedances(ORIGIN, level, f)[0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("level", [0.0, LEVEL])
def test_negative_damping_ends_where_it_has_cancelled_all_there_is(rigid, level):
    """Colgate and Schenkel at DC: b > |B|, whatever the filter; a rigid device without friction."""
    assert rigid.limit(level, 1, -12.0) == pytest.approx(-(VISCOUS + level), rel=2e-3)


def test_stiffness_limit_grows_by_two_over_the_period(rigid):
    """Weir 2008, Eq. 2 at B = 0: K < 2 b / T, so a N s/m of active damping buys 2,000 N/m. White
    noise sees the same.
    """
    assert (rigid.limit(LEVEL, 0) - rigid.limit(0.0, 0)) / LEVEL == pytest.approx(2000.0, rel=5e-3)


def test_corner_takes_stiffness_from_a_sampled_spring(rigid):
    """K T / 2 is needed at every frequency (Colgate and Schenkel 1997); at 2 Hz a corner of 10
    Hz leaves 4/104 of the damping.
    """
    left = VISCOUS + LEVEL * 2.0**2 / (2.0**2 + 10.0**2)
    assert rigid.shaped(highpass_hz=10.0).limit(LEVEL, 0) == pytest.approx(2000.0 * left, rel=5e-3)


def test_safest_leaves_nothing_to_spare_but_something(rigid):
    damping, mass_kg = lightest_safe(rigid, LEVEL, -3.0, 0.0)
    step = 3.0 / 40
    assert mass_kg == 0.0
    assert -(VISCOUS + LEVEL) < damping < -(VISCOUS + LEVEL) + step


def test_safest_holds_for_every_input_not_only_for_noise(rigid):
    """On this grid the lightest point that noise calls passive is 6 mN s/m short of the lifted
    theorem.
    """
    asked = lightest_safe(rigid, LEVEL, -2.0, -0.012)
    lifted = lifted_system(rigid.display.model, LEVEL, rigid.display.filters)
    assert lifted_margin(lifted, [(0.0, *asked)])[0] >= 0.0
    tempting = np.array([[0.0, -1.8, -0.003]])
    assert rigid.display.passive(tempting, LEVEL, dry=False)[0]
    assert lifted_margin(lifted, tempting)[0] < 0.0


def test_safest_refuses_a_device_that_bears_nothing():
    bare = bench((*PARTS_OF_RIGID[:2], Viscous(rotor_ns_per_m=0.0)))
    with pytest.raises(
        AnalysisError,
        match=r"'small' at 0 N s/m: not passive without friction even for a free display",
    ):
        lightest_safe(bare, 0.0, -1.0, 0.0)


def test_equation_2_refuses_what_it_would_wrongly_allow(rigid):
    """As printed, b > KT/2 + B calls any B < 0 passive; the device with 1.9 N s/m does not bear
    -2.5.
    """
    point = np.array([[0.0, -2.5, 0.0]])
    assert not rigid.display.passive(point, LEVEL)[0]
    with pytest.raises(AnalysisError, match=r"Eq\. 2 does not hold for B = -2\.5 N s/m"):
        paper_equation_2(0.0, -2.5, VISCOUS + LEVEL)
    assert free_motion(rigid, LEVEL, ()).refusal.startswith("Eq. 2 does not hold for B = -")


def test_grid_is_the_papers_with_rows_of_negative_damping():
    assert len(GRID) == len(AXES[0]) * (len(AXES[1]) + 8) * len(AXES[2])
    assert set(np.round(np.unique(GRID[:, 1]), 9)) >= set(np.round(AXES[1], 9))
    assert np.unique(np.diff(np.unique(GRID[:, 1]))) == pytest.approx([0.5])


class Fragile(Bench):
    """Trials that show what is predicted, and in which some environments fail with one seed."""

    def trials(self, points, level, seed, amplitude=1.0):
        z = self.display.impedances(points, level, shown_hz())
        return [
            self._outcome(point, row, level, seed, amplitude)
            for point, row in zip(points, z, strict=True)
        ]

    def _outcome(self, point, z, level, seed, amplitude):
        whole = np.ones(kept_frequencies().size, np.complex128)
        whole[np.isin(kept_frequencies(), shown_hz())] = z
        good = not (point[1] < -1.0 and seed == 2) and amplitude == 1.0
        return Outcome(
            tuple(point), level, "passive", good, 0.1, 0.05, 0.2, 1.0, 3.0, 0.02, 1.0,
            np.column_stack((whole.real, whole.imag)), np.zeros(whole.size),
        )  # fmt: skip


def test_environment_that_fails_with_one_seed_is_struck_out_for_good():
    display = Fragile(bench(PARTS_OF_RIGID).conditions)
    case = Case("on", LEVEL, negative=True)
    found = bounds_of(display, case, (1, 2, 3), SMALL)
    owners = found.points[np.concatenate((found.lower.owner, found.upper.owner))]
    assert owners[:, 1].min() >= -1.0
    assert found.excluded > 0
    assert found.predicted_db() < found.lower_db().mean()
    sound = candidates(display, case, SMALL)
    sound = sound[sound[:, 1] >= -1.0]
    assert found.lower.value == pytest.approx(display.sizes(sound, LEVEL).min(axis=0), rel=1e-9)
    assert passing_twice(display, found, 1) == 0.0
    assert passing_twice(display, found, 1, amplitude=1.0) == 1.0


def test_positive_case_renders_no_negative_damping(rigid):
    assert candidates(rigid, Case("on", LEVEL), SMALL)[:, 1].min() == 0.0
    assert candidates(rigid, Case("on", LEVEL, negative=True), SMALL)[:, 1].min() < 0.0


def test_what_counts_on_friction_is_more_than_what_does_not():
    """With Coulomb friction the safe set lies inside the other."""
    own = bench(DRY).display
    at_noise, safe = (own.passive(SMALL, LEVEL, dry=dry) for dry in (True, False))
    assert (safe <= at_noise).all()
    assert 0 < safe.sum() < at_noise.sum()


def test_owners_that_are_shown_pass_when_flown_alone():
    """The real engine: 90 s trials of a device with friction, one seed, few environments."""
    display = bench(DRY, excitation=replace(scene().excitation, seed=4))
    case = Case("on", LEVEL, negative=True, dry=False)
    few = SMALL[(SMALL[:, 0] <= 25.0) & (np.abs(SMALL[:, 2]) < 0.007)]
    found = bounds_of(display, case, (4,), few)
    places, where = np.unique(found.lower.owner, return_inverse=True)
    fresh = Bench(display.conditions).trials(found.points[places], LEVEL, 4)
    assert all(outcome.passes for outcome in fresh)
    own = np.array([sizes(outcome) for outcome in fresh])[where, np.arange(where.size)]
    assert own == pytest.approx(found.lower.value, rel=1e-9)
    assert found.points[found.lower.owner][0, 1] < 0.0


def test_limit_is_searched_downwards_with_every_seed(monkeypatch):
    monkeypatch.setattr(outcomes, "run_trials", made_up)
    (found,) = bench(PARTS_OF_RIGID).limits((LEVEL,), (1, 2), (1,), (REACH[0], -12.0, REACH[2]))
    assert (found.level, found.axis) == (LEVEL, 1)
    assert found.predicted == pytest.approx(-(VISCOUS + LEVEL), rel=2e-3)
    assert found.values == pytest.approx([-1.0, -1.0], rel=FINE)
    (alone,) = bench(PARTS_OF_RIGID).limits((LEVEL,), (), (1,), (REACH[0], -12.0, REACH[2]))
    assert not alone.values.size


def test_each_environment_is_flown_once(monkeypatch):
    display = bench(DRY)
    asked = []

    def flying(given, level, points):
        asked.extend(map(tuple, points))
        return made_up(given, level, points)

    monkeypatch.setattr(outcomes, "run_trials", flying)
    display.trials(SMALL[:3], LEVEL, 1)
    found = display.trials(SMALL[:5], LEVEL, 1)
    assert [outcome.environment for outcome in found] == [
        tuple(point) for point in SMALL[:5].tolist()
    ]
    assert len(asked) == 5
    display.trials(SMALL[:1], LEVEL, 2)
    assert len(asked) == 6


def test_every_predicted_owner_is_passive_and_stable(quick):
    """Re Z >= 0 in the band and a spectral radius below 1 for every point that an edge shows;
    safe ones without friction too.
    """
    display = quick.plan.bench.display
    for found in quick.envelopes.values():
        owners = found.points[np.unique(np.concatenate((found.lower.owner, found.upper.owner)))]
        rules = [display.perturbation] if found.case.dry else [display.perturbation, None]
        for rule in rules:
            judged = predict(display.model, owners, found.case.level, display.filters, rule)
            assert judged.passive.all()
            assert judged.margin_ns_per_m.min() >= 0.0
            assert judged.spectral_radius.max() < 1.0


def test_safe_free_motion_has_damping_to_spare(quick):
    names = [motion.name for motion in quick.free.motions]
    assert names == ["off", "on", "on_negative_B", "on_negative_BM"]
    assert all(motion.reserve_ns_per_m >= 0.0 for motion in quick.free.motions)
    off, on, alone, both = (motion.low_db()[0] for motion in quick.free.motions)
    assert off < both < alone < on


def test_best_corner_keeps_damping_and_mass(quick):
    shaped = quick.shaped
    assert shaped.best in shaped.highpass
    for axis in (1, 2):
        assert shaped.best.limits[axis] / shaped.plain.limits[axis] >= 0.95
    assert shaped.best.free_db < shaped.plain.free_db
    assert shaped.best.limits[0] < shaped.plain.limits[0]  # what it costs on a device that lags


def test_levels_grow_and_no_grid_cuts_them(quick):
    levels = quick.levels
    assert (np.diff(np.abs(levels.limits), axis=0) > 0.0).all()
    assert (np.diff(levels.volume) > 0.0).all()
    assert levels.open_ends == ()
    assert levels.gain(0.87, 3.48) == pytest.approx((levels.limits[3] - levels.limits[1]) / 2.61)


def test_set_of_a_linear_device_grows_with_the_cube_of_its_damping(monkeypatch):
    """Where every limit is in proportion to b, K B and M together are in proportion to b^3."""
    monkeypatch.setattr(future_work, "DAMPING_LEVELS", (0.0, 0.2))
    monkeypatch.setattr(future_work, "TRIED_LEVELS", ())
    monkeypatch.setattr(future_work, "HEAVIEST", 2.6)
    heavy = bench((Masses(rotor_kg=1.0), PARTS_OF_RIGID[1], Viscous(rotor_ns_per_m=0.2)))
    found = damping_levels(heavy, ())
    assert found.limits[1] / found.limits[0] == pytest.approx([2.0, 2.0, 2.0], rel=0.02)


def test_scatter_needs_two_seeds():
    assert mean_sd(np.array([1.0, 3.0])) == (2.0, pytest.approx(np.sqrt(2.0)))
    assert np.isnan(mean_sd(np.array([1.0]))[1])


def test_plan_counts_seeds_and_tells_its_steps(monkeypatch):
    assert plan_future_work(seeds=4).seeds == (1, 2, 3, 4)
    plan = plan_future_work(quick=True)
    told = []
    for name in ("bounds_of", "free_motion", "shaped_damping", "damping_levels"):
        monkeypatch.setattr(future_work, name, lambda *given: None)
    run_future_work(plan, lambda what, done, total: told.append((what, done, total)))
    assert told[0] == ("envelope, off", 0, 10)
    assert told[-1] == ("done", 10, 10)


def test_prediction_alone_has_no_uncertainty(rigid):
    found = bounds_of(rigid, Case("on", LEVEL), points=SMALL)
    assert not found.lower.sd.any()
    assert (found.trials, found.excluded) == (0, 0)
    assert found.predicted_db() == found.lower_db()[0]
