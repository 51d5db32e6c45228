"""Effects left out: what they change, and what is proposed, each against a closed form."""

from dataclasses import replace
from math import inf, isnan
from typing import Any

import numpy as np
import pytest
from support.measured_scenes import PARTS, VISCOUS_NS_PER_M, scene, stopwatch

from hapticd.core.errors import AnalysisError, ConfigError
from hapticd.model.effects import Amplifier, Saturation, WindingTemperature
from hapticd.settings.scene import load_scene
from hapticd.studies import effects
from hapticd.studies.effects import (
    PREDICTED,
    QUESTIONS,
    SIMULATED,
    EffectsParams,
    limits,
    peak,
    plan_effects,
    relative,
    run_effects,
)
from hapticd.zwidth import outcomes
from hapticd.zwidth.engine.batch import BatchResult, simulate
from hapticd.zwidth.outcomes import Conditions, run_trials
from hapticd.zwidth.sources import frequencies

AMPLIFIED = (*PARTS, Saturation(limit_n=8.0))


# --- quantities -----------------------------------------------------------------------------------


def test_predicted_stiffness_limit_is_twice_b_over_t() -> None:
    """Colgate and Schenkel 1997: K < 2 b / T for a rigid device without delay; exact for the
    first harmonic as well.
    """
    found = limits(EffectsParams(scene()), scene(), PREDICTED)
    assert found[0] == pytest.approx(2.0 * VISCOUS_NS_PER_M * 1000.0, rel=1e-3)
    assert found[1] == pytest.approx(2.18, rel=0.02)
    assert found[2] < 0.0


def test_saturated_or_diverged_trials_do_not_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = Conditions(scene(AMPLIFIED), 8.0)
    points = np.array([(100.0, 0.0, 0.0)] * 3)
    limit_n = asked.display.force_limit_n
    assert [outcome.passes for outcome in run_trials(asked, 0.0, points)] == [True] * 3

    def stand_in(*given: Any, **more: Any) -> BatchResult:
        found = simulate(*given, **more)
        ended = replace(found, samples=np.array([found.samples[0], found.samples[1], 100]))
        return replace(ended, max_force_n=np.array([0.5, 1.0, 0.5]) * limit_n)

    monkeypatch.setattr(outcomes, "simulate", stand_in)
    assert [outcome.passes for outcome in run_trials(asked, 0.0, points)] == [True, False, False]


def test_change_is_the_largest_of_the_limits() -> None:
    asked = QUESTIONS["limits"]
    full = np.array([100.0, 2.0, -0.01])
    assert asked.compare(full, np.array([103.0, 1.9, -0.01]))[0] == pytest.approx(0.05)
    assert asked.compare(full, np.array([np.nan, 2.0, -0.01]))[0] == inf
    assert asked.compare(full * np.nan, full * np.nan)[0] == 0.0
    assert asked.compare(full, full)[1] == {"K N/m": 100.0, "B N s/m": 2.0, "M g": -10.0}


def test_limit_of_nothing_has_no_relative_change() -> None:
    with pytest.raises(
        AnalysisError,
        match="a limit of 0 has no relative change; widen the band or strengthen the device",
    ):
        relative(0.0, 1.0)


def test_phase_change_knows_that_the_circle_closes() -> None:
    full = np.full(frequencies().size, 179.0)
    assert QUESTIONS["phase"].compare(full, -full)[0] == pytest.approx(2.0 / 90.0)


def test_peak_that_goes_away_is_a_change_without_measure() -> None:
    asked = QUESTIONS["peak"]
    there = np.array([7.5, 85.0])
    change, numbers = asked.compare(there, np.array([7.5, np.nan]))
    assert change == inf
    assert isnan(numbers["at Hz"])
    assert asked.compare(there, np.array([7.8, 85.0]))[0] == pytest.approx(0.04)


def test_peak_of_figure_8_lies_near_100_hz(monkeypatch: pytest.MonkeyPatch) -> None:
    """Weir 2008, section 5: a peak of the damped envelope near 100 Hz, owned by negative
    virtual mass; none without damping.
    """
    damped = load_scene("fig7")
    undamped = load_scene("fig4")
    monkeypatch.setattr(effects, "peak_mass_kg", lambda params: -0.022)
    height, frequency_hz = peak(EffectsParams(damped), damped, PREDICTED)
    assert 75.0 < frequency_hz < 100.0
    assert 20.0 * np.log10(height) == pytest.approx(17.4, abs=0.5)
    monkeypatch.setattr(effects, "peak_mass_kg", lambda params: -0.006)
    assert isnan(peak(EffectsParams(undamped), undamped, PREDICTED)[1])


# --- leaving effects out --------------------------------------------------------------------------


def test_unknown_question_and_tolerance_are_refused() -> None:
    with pytest.raises(ConfigError, match="question 'width': use one of limits, phase, peak"):
        plan_effects(EffectsParams(scene(), "width"))
    with pytest.raises(ConfigError, match=r"tolerance 0: must be above 0; 0\.02 is 2 %"):
        plan_effects(EffectsParams(scene(), tolerance=0.0))


def test_scene_without_dissipation_has_no_peak() -> None:
    with pytest.raises(
        AnalysisError,
        match="'small': not passive even without an environment, so no mass owns a peak",
    ):
        plan_effects(EffectsParams(scene().without("viscous"), "peak"))


def test_linear_effects_are_predicted_and_others_simulated() -> None:
    plan = plan_effects(EffectsParams(load_scene("fig7")))
    assert plan.methods["coulomb"] == plan.methods["encoder"] == SIMULATED
    assert plan.methods["smoothing"] == PREDICTED
    assert not {"masses", "motor"} & set(plan.methods)


def test_effect_that_another_needs_cannot_be_left_out() -> None:
    """A resistance error without any lag is refused by `compose`; the reason is kept."""
    small = scene(
        (
            *PARTS,
            Amplifier(bandwidth_hz=5000.0),
            WindingTemperature(temperature_c=30.0, compensated_c=20.0),
        ),
        1.0,
    )
    found = run_effects(plan_effects(EffectsParams(small, "phase", 0.5, 5.0)), stopwatch())
    amplifier = next(row for row in found.rows if row.effect == "amplifier")
    assert amplifier.change == inf
    assert "needs a lag" in amplifier.note
    assert "amplifier" in found.kept
