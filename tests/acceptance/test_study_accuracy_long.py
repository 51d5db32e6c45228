"""What accuracy costs: the knee, both comparisons against closed forms, and trials in lock-step."""

from math import inf

import numpy as np
import pytest
from support.measured_scenes import DRY, scene, stopwatch

from hapticd.model.compose import compose
from hapticd.model.predict import predicted_impedance
from hapticd.model.scene import Excitation
from hapticd.settings.scene import load_scene
from hapticd.studies.accuracy import (
    PhaseComparison,
    PositionComparison,
    Setting,
    phase_rms,
    plan_accuracy,
    run_accuracy,
)
from hapticd.studies.effects import GROUP
from hapticd.zwidth.sources import frequencies

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
    assert max(one.step for one in found.sweep("sub-steps") if one.note != "the reference") < 1e-9
    assert max(one.step for one in found.sweep("precision")) < 1e-2
    assert (
        len(
            {round(one.total, 3) for one in found.sweep("sub-steps") if one.note != "the reference"}
        )
        == 1
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
        for each in (scene_, scene_.without("probe"))
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
