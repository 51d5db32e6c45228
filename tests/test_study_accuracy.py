"""What accuracy costs: the knee, both gauges against closed forms, lock-step trials, explicit
methods.
"""

from math import exp, inf, nan

import numpy as np
import pytest
from measured_scenes import DRY, MASS_KG, VISCOUS_NS_PER_M, scene, stopwatch

from hapticd.analysis.predict import predicted_impedance
from hapticd.engine import simulate
from hapticd.errors import AnalysisError
from hapticd.plant.compose import compose
from hapticd.plant.scene import Excitation
from hapticd.settings.scene import load_scene
from hapticd.study.accuracy import (
    GROUP,
    REFERENCE,
    AccuracyRow,
    PhaseComparison,
    PositionComparison,
    Setting,
    cheapest_near_best,
    mark_knees,
    phase_rms,
    plan_accuracy,
    run_accuracy,
)
from hapticd.study.scene import compare_integrators
from hapticd.zwidth.lockstep import MOST_S, fly
from hapticd.zwidth.scenes import frequencies, without
from hapticd.zwidth.simulated import spectra_on

# --- the knee -------------------------------------------------------------------------------------


def row(seconds: float, total: float, sweep: str = "s") -> AccuracyRow:
    return AccuracyRow(sweep, "", seconds, nan, total)


def test_knee_is_cheapest_within_ten_percent_of_best() -> None:
    rows = [row(1.0, 2.0), row(2.0, 1.09), row(4.0, 1.0), row(8.0, 1.05)]
    assert cheapest_near_best(rows) is rows[1]
    assert cheapest_near_best([row(1.0, 1.11), row(2.0, 1.0)]).seconds == 2.0  # type: ignore[union-attr]


def test_knee_ignores_what_was_not_measured() -> None:
    rows = [row(nan, 0.1), row(1.0, inf), row(0.5, nan), row(2.0, 1.0)]
    assert cheapest_near_best(rows) is rows[3]
    assert cheapest_near_best(rows[:3]) is None


def test_every_sweep_has_one_knee_and_effects_none() -> None:
    marked = list(
        mark_knees(
            [row(1.0, 1.0, "a"), row(2.0, 1.0, "a"), row(1.0, 5.0, "b"), row(1.0, 1.0, "effect")]
        )
    )
    assert [one.knee for one in marked] == [True, False, True, False]


# --- a linear scene, exactly known ----------------------------------------------------------------


@pytest.fixture(scope="module")
def linear():
    """Measured on the shipped scene of sampled-data theory."""
    plan = plan_accuracy(load_scene("theory"), "theory", quick=True)
    heard: list[tuple[str, int, int]] = []
    found = run_accuracy(plan, stopwatch(), lambda *told: heard.append(told))
    return found, heard


def test_linear_scene_is_measured_against_its_exact_answer(linear) -> None:
    found, _ = linear
    assert found.reference == "exact first harmonic of the linear scene"
    assert [row.total for row in found.sweep("tier")[:2]] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert found.unit == "deg"


def test_linear_scene_has_no_step_error(linear) -> None:
    found, _ = linear
    assert max(one.step for one in found.sweep("sub-steps") if one.note != REFERENCE) < 1e-9
    assert max(one.step for one in found.sweep("precision")) < 1e-2
    assert (
        len({round(one.total, 3) for one in found.sweep("sub-steps") if one.note != REFERENCE}) == 1
    )


def test_longer_trials_and_the_papers_window_are_better(linear) -> None:
    found, _ = linear
    short, long = (one.total for one in found.sweep("trial length"))
    coarse, fine = (one.total for one in found.sweep("window"))
    assert 1.2 < short / long < 3.0
    assert fine < 0.7 * coarse


def test_default_is_in_every_sweep_that_has_it(linear) -> None:
    found, _ = linear
    totals = {one.total for one in found.rows if one.default}
    assert totals == {found.default.total}
    assert {one.sweep for one in found.rows if one.default} == {
        "tier",
        "sub-steps",
        "precision",
        "trial length",
        "window",
    }


def test_left_out_effect_errs_by_what_the_theory_says(linear) -> None:
    """Without the probe the mass is 5 g instead of 8: the phase between two exact answers,
    within the trials' chance.
    """
    found, _ = linear
    scene_ = load_scene("theory")
    f = frequencies()
    whole, light = (
        predicted_impedance(compose(each), (1000.0, 0.0, 0.0), f)
        for each in (scene_, without(scene_, "probe"))
    )
    probe = next(one for one in found.sweep("effect") if one.label == "probe")
    assert probe.step == pytest.approx(phase_rms(light / whole), rel=0.05)


def test_what_cannot_be_left_out_says_why(linear) -> None:
    found, _ = linear
    viscous = next(one for one in found.sweep("effect") if one.label == "viscous")
    assert (viscous.total, viscous.seconds != viscous.seconds) == (inf, True)
    assert "not stable" in viscous.note


def test_lockstep_is_a_tier_with_the_chance_of_its_length(linear) -> None:
    found, _ = linear
    stack = found.sweep("tier")[-1]
    assert stack.label == "lock-step 5 s"
    assert stack.total == pytest.approx(found.sweep("trial length")[0].total, rel=0.8)


def test_progress_counts_to_its_end(linear) -> None:
    _, heard = linear
    assert [done for _, done, _ in heard] == sorted(done for _, done, _ in heard)
    assert heard[-1] == ("done", heard[-1][2], heard[-1][2])
    assert max(done for _, done, _ in heard[:-1]) < heard[-1][2]


# --- friction: the step error is of first order ---------------------------------------------------


def test_friction_error_is_of_first_order_in_the_step() -> None:
    small = scene(DRY, seconds=8.0, kbm=(50.0, 0.5, 0.0))
    comparison = PhaseComparison(small, "", Setting(8.0, 16), stopwatch())
    assert "16 sub-steps" in comparison.reference
    one, two, four = (comparison.measure(Setting(8.0, count)) for count in (1, 2, 4))
    assert 1.6 < one.step / two.step < 3.5
    assert 1.6 < two.step / four.step < 4.5
    assert four.total >= four.step
    assert comparison.cost(Setting(8.0, 1)) == pytest.approx(1e-3 / GROUP + 1e-3 / 8)


# --- pushed scenes --------------------------------------------------------------------------------


def test_trace_error_is_position_with_the_encoders_rounding() -> None:
    pushed = scene(
        DRY, seconds=0.4, kbm=(100.0, 1.0, 0.0), excitation=Excitation("push", force_n=0.5)
    )
    comparison = PositionComparison(pushed, "", Setting(0.4, 16), stopwatch())
    exact = comparison.measure(Setting(0.4, 16))
    coarse = comparison.measure(Setting(0.4, 1))
    assert (exact.step, exact.total) == (0.0, pytest.approx(0.5 / np.sqrt(12.0)))
    assert coarse.step > 0.0
    assert coarse.total == pytest.approx(np.hypot(coarse.step, exact.total))


@pytest.mark.slow
def test_lockstep_flies_a_push_as_the_engine_does() -> None:
    toggle = load_scene("toggle")
    comparison = PositionComparison(toggle, "toggle", Setting(3.0, 4), stopwatch())
    found = comparison.lockstep(3.0)
    assert found.step < 1.0  # um; two counts, after damping has been switched
    assert found.seconds == pytest.approx(1e-3)


def test_lockstep_refuses_a_scene_that_begins_in_motion() -> None:
    comparison = PositionComparison(load_scene("wall"), "wall", Setting(1.0), stopwatch())
    with pytest.raises(AnalysisError, match="the scene begins in motion, lock-step at rest"):
        comparison.lockstep(1.0)


# --- trials with the whole product ----------------------------------------------------------------


def test_flown_trial_plays_the_forces_it_was_given() -> None:
    force = np.random.default_rng(1).normal(0.0, 0.2, 4000)
    flown = fly("theory", force, [(0.0, 0.0)])
    played = flown.torque_n[np.flatnonzero(flown.torque_n)[0] :]
    assert np.abs(played - force[: len(played)]).max() <= 0.51 * 2.0 / 32767
    assert (len(flown.position_m), len(flown.torque_n)) == (1000, 4000)


def test_flown_trial_has_the_impedance_of_the_engine() -> None:
    """Same forces, same counts: the two spectra differ by the rounding of the record alone."""
    theory = load_scene("theory")
    f = frequencies()
    force = np.random.default_rng(2).normal(0.0, 0.2, 24_000)
    flown = fly("theory", force, [(0.0, 0.0)])
    like = simulate(theory, [(1000.0, 0.0, 0.0)], 6.0, excitation=flown.torque_n, keep="records")
    one = spectra_on(flown.torque_n, flown.velocity_m_per_s, f)
    other = spectra_on(*like.record(0), f)
    assert phase_rms((one.cross / one.velocity) / (other.cross / other.velocity)) < 0.2


def test_flown_trial_is_no_longer_than_the_waveform() -> None:
    with pytest.raises(
        AnalysisError, match=rf"in lock-step: the waveform holds {MOST_S:g} s; ask for less"
    ):
        fly("theory", np.zeros(round(4000 * MOST_S) + 1), [])


# --- explicit methods -----------------------------------------------------------------------------


def test_explicit_methods_are_stable_up_to_their_textbook_step() -> None:
    """One real pole at b/m: Euler up to 2 m/b, Runge-Kutta 4 up to 2.7853 m/b."""
    found = compare_integrators(scene())
    pole = VISCOUS_NS_PER_M / MASS_KG
    assert found.longest_s["euler"] == pytest.approx(2.0 / pole, rel=1e-9)
    assert found.longest_s["rk4"] == pytest.approx(2.785293563405282 / pole, rel=1e-9)
    assert found.longest_s["exact"] == inf
    assert found.fastest_s == pytest.approx(1.0 / pole)


def test_errors_fall_with_the_order_of_the_method() -> None:
    found = compare_integrators(scene())
    euler = found.error["euler"]
    rk4 = found.error["rk4"]
    assert euler[3] / euler[4] == pytest.approx(2.0, rel=0.02)
    assert rk4[0] / rk4[1] == pytest.approx(16.0, rel=0.1)
    assert found.error["exact"].max() < 1e-11
    # one step a millisecond; the error of the velocity is largest after one time constant
    step = 1e-3 * VISCOUS_NS_PER_M / MASS_KG
    times = np.arange(1, 21)
    expected = np.abs((1.0 - step) ** times - np.exp(-step * times)).max() / exp(-step)
    assert euler[0] == pytest.approx(expected, rel=1e-6)


def test_stiff_electronics_blow_explicit_methods_up() -> None:
    found = compare_integrators(load_scene("fig7"))
    steps = found.steps_per_ms
    assert 8.5e-5 < found.longest_s["rk4"] < 9.5e-5
    assert np.isinf(found.error["rk4"][steps <= 8]).all()
    assert np.isfinite(found.error["rk4"][steps >= 16]).all()
    assert found.error["exact"].max() < 1e-11


def test_device_that_only_drifts_is_stable_with_any_method() -> None:
    found = compare_integrators(without(scene(), "viscous"))
    assert set(found.longest_s.values()) == {inf}
    assert found.fastest_s == inf
    assert found.error["euler"].max() < 1e-9
