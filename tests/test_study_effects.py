"""Effects left out, ceilings of damping, and scenes run twice: each against a closed form."""

from dataclasses import replace
from math import inf, isnan
from typing import Any

import numpy as np
import pytest
from measured_scenes import MASS_KG, MOTOR, PARTS, VISCOUS_NS_PER_M, scene, stopwatch

from hapticd.engine import BatchResult, simulate
from hapticd.errors import AnalysisError, ConfigError
from hapticd.plant.effects import (
    Amplifier,
    Coupling,
    Crowbar,
    DampingCircuit,
    Saturation,
    Viscous,
    WindingTemperature,
    copper_ohm,
)
from hapticd.plant.scene import DampingStep, Excitation
from hapticd.settings.scene import load_scene
from hapticd.study.effects import (
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
from hapticd.study.scene import ceiling, plan_scene, run_scene
from hapticd.zwidth import outcomes
from hapticd.zwidth.outcomes import Conditions, run_trials
from hapticd.zwidth.scenes import frequencies, is_linear, without

AMPLIFIED = (*PARTS, Saturation(limit_n=8.0))
CIRCUIT = (*PARTS, Amplifier(bandwidth_hz=5000.0), DampingCircuit(bandwidth_hz=1000.0))


# --- quantities -----------------------------------------------------------------------------------


def test_predicted_stiffness_limit_is_twice_b_over_t() -> None:
    """Colgate and Schenkel 1997: K < 2 b / T for a rigid device without delay; exact for the
    first harmonic as well.
    """
    found = limits(EffectsParams(scene()), scene(), PREDICTED)
    assert found[0] == pytest.approx(2.0 * VISCOUS_NS_PER_M * 1000.0, rel=1e-3)
    assert found[1] == pytest.approx(2.18, rel=0.02)
    assert found[2] < 0.0


def test_simulated_mass_limit_agrees_with_prediction() -> None:
    asked = EffectsParams(scene(), seconds=12.0)
    assert limits(asked, scene(), SIMULATED)[2] == pytest.approx(
        limits(asked, scene(), PREDICTED)[2], rel=0.08
    )


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
    assert asked.change(full, np.array([103.0, 1.9, -0.01])) == pytest.approx(0.05)
    assert asked.change(full, np.array([np.nan, 2.0, -0.01])) == inf
    assert asked.change(full * np.nan, full * np.nan) == 0.0
    assert asked.named(full, full) == {"K N/m": 100.0, "B N s/m": 2.0, "M g": -10.0}


def test_limit_of_nothing_has_no_relative_change() -> None:
    with pytest.raises(
        AnalysisError,
        match="a limit of 0 has no relative change; widen the band or strengthen the device",
    ):
        relative(0.0, 1.0)


def test_phase_change_knows_that_the_circle_closes() -> None:
    full = np.full(frequencies().size, 179.0)
    assert QUESTIONS["phase"].change(full, -full) == pytest.approx(2.0 / 90.0)


def test_peak_that_goes_away_is_a_change_without_measure() -> None:
    asked = QUESTIONS["peak"]
    there = np.array([7.5, 85.0, 1.0])
    gone = np.array([7.5, 85.0, 0.0])
    assert asked.change(there, gone) == inf
    assert asked.change(there, np.array([7.8, 85.0, 1.0])) == pytest.approx(0.04)
    assert isnan(asked.named(there, gone)["at Hz"])


def test_peak_of_figure_8_lies_near_100_hz() -> None:
    """Weir 2008, section 5: a peak of the damped envelope near 100 Hz, owned by negative
    virtual mass; none without damping.
    """
    damped = load_scene("fig7")
    undamped = load_scene("fig4")
    height, frequency_hz, inside = peak(EffectsParams(damped), damped, PREDICTED, -0.022)
    assert (75.0 < frequency_hz < 100.0, inside) == (True, 1.0)
    assert 20.0 * np.log10(height) == pytest.approx(17.4, abs=0.5)
    assert peak(EffectsParams(undamped), undamped, PREDICTED, -0.006)[2] == 0.0


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
        plan_effects(EffectsParams(without(scene(), "viscous"), "peak"))


def test_linear_effects_are_predicted_and_others_simulated() -> None:
    plan = plan_effects(EffectsParams(load_scene("fig7")))
    assert plan.methods["coulomb"] == plan.methods["encoder"] == SIMULATED
    assert plan.methods["smoothing"] == PREDICTED
    assert not {"masses", "motor"} & set(plan.methods)


def test_cheapest_set_keeps_what_dissipates_and_drops_a_stiff_coupling() -> None:
    """A coupling of 1e6 N/m is not seen below 500 Hz; without viscous friction all of Z is the
    mass's, at 90 degrees.
    """
    stiff = replace(PARTS[0], slider_kg=0.001, rotor_kg=MASS_KG - 0.001)
    small = scene(
        (
            stiff,
            MOTOR,
            Coupling(stiffness_n_per_m=1e6, damping_ns_per_m=50.0),
            Viscous(rotor_ns_per_m=1.0),
        ),
        seconds=6.0,
    )
    heard: list[str] = []
    found = run_effects(
        plan_effects(EffectsParams(small, "phase", 0.05, 6.0)),
        stopwatch(),
        lambda what, done, total: heard.append(what),
    )
    by_effect = {row.effect: row for row in found.rows}
    turned = 90.0 - np.degrees(np.arctan(2.0 * np.pi * 2.9297 * MASS_KG / VISCOUS_NS_PER_M))
    assert by_effect["viscous"].change == pytest.approx(turned / 90.0, rel=1e-3)
    assert by_effect["coupling"].change < 0.05
    assert found.kept == ("viscous",)
    assert found.proposal.change <= 0.05
    assert heard[-1] == "done"


def test_question_without_an_answer_keeps_everything() -> None:
    bare = scene(
        (PARTS[0], MOTOR, Coupling(stiffness_n_per_m=1e5, damping_ns_per_m=0.0)), seconds=5.0
    )
    bare = replace(bare, effects=(replace(PARTS[0], slider_kg=0.001), *bare.effects[1:]))
    found = run_effects(plan_effects(EffectsParams(bare, "limits", 0.02, 5.0)), stopwatch())
    assert all(isnan(number) for number in found.whole[0].numbers.values())
    assert found.kept == ("coupling",)


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


# --- ceilings -------------------------------------------------------------------------------------


def test_ceiling_is_that_of_routh() -> None:
    """(m s + b)(s + wa)(s + wd) + g wa wd: stable while the two inner coefficients beat the two
    outer ones.
    """
    wa = 2.0 * np.pi * 5000.0
    wd = 2.0 * np.pi * 1000.0
    m = MASS_KG
    b = VISCOUS_NS_PER_M
    routh = (m * (wa + wd) + b) * (m * wa * wd + b * (wa + wd)) / (m * wa * wd) - b
    found = ceiling(scene(CIRCUIT, 1.74))
    assert found.device == pytest.approx(routh, rel=1e-6)
    assert found.oscillation_hz == pytest.approx(
        np.sqrt((m * wa * wd + b * (wa + wd)) / m) / (2.0 * np.pi), rel=1e-4
    )
    assert (found.scene, found.loop_gain, found.warmer) == (1.74, 0.0, ())


def test_cold_winding_bounds_damping_by_what_is_over_compensated() -> None:
    """g dR / K^2 = -1 cannot be passed; a slow circuit gets close to it, a hot winding has no
    such bound.
    """
    found = ceiling(
        scene((*CIRCUIT, WindingTemperature(temperature_c=20.0, compensated_c=20.0)), 1.74)
    )
    warmer = dict(found.warmer)
    for kelvin in (-40.0, -20.0):
        excess_ohm = copper_ohm(1.6, 20.0, 20.0 + kelvin) - 1.6
        bound = -(1.65**2) / excess_ohm
        assert 0.85 * bound < warmer[kelvin] <= bound
    assert warmer[0.0] == found.device
    assert warmer[40.0] == warmer[10.0] == inf


def test_loop_is_stable_between_its_lowest_and_highest_damping() -> None:
    """A spring of 4 kN/m needs more than the device's own 1 N s/m; what is needed does not
    depend on where it comes from.
    """
    needy = scene(CIRCUIT, 1.74, kbm=(4000.0, 0.0, 0.0))
    found = ceiling(needy)
    assert 0.5 < found.lowest < 3.0
    assert found.lowest < found.highest <= found.device * 1.001
    assert ceiling(scene(CIRCUIT, 1.74)).lowest == 0.0


def test_shorted_motor_has_no_ceiling() -> None:
    with pytest.raises(
        ConfigError, match="the motor is shorted and obeys no damping command; leave out 'crowbar'"
    ):
        ceiling(scene((*PARTS, Crowbar())))


# --- scenes, twice --------------------------------------------------------------------------------


def test_undamped_scene_is_compared_with_damping_on() -> None:
    plan = plan_scene(scene(seconds=10.0))
    assert [case.damping for case in plan.cases] == [((0.0, 0.0),), ((0.0, 1.74),)]
    assert [case.own for case in plan.cases] == [True, False]
    assert plan.impedance


def test_switched_scene_keeps_its_steps() -> None:
    steps = (DampingStep(0.0, 0.0), DampingStep(2.0, 3.0), DampingStep(4.0, 0.0))
    plan = plan_scene(replace(scene(seconds=10.0), damping=steps), seconds=1.0)
    assert plan.cases[1].damping == ((0.0, 0.0), (2.0, 3.0), (4.0, 0.0))
    assert plan.cases[1].name == "active damping 3 N s/m, switched"
    assert (plan.cases[1].own, plan.seconds, plan.impedance) == (True, 1.0, False)


def test_free_mass_shows_its_impedance_with_and_without_damping() -> None:
    """Z = b + j w m; 1.74 N s/m more of electrical damping are 1.74 N s/m more of resistance."""
    found = run_scene(plan_scene(scene(seconds=20.0)))
    plain, damped = (trial.judged and trial.judged.measured for trial in found.trials)
    assert plain is not None
    assert damped is not None
    at = int(np.argmin(np.abs(plain.frequency_hz - 20.0)))
    expected = VISCOUS_NS_PER_M + 2j * np.pi * plain.frequency_hz[at] * MASS_KG
    assert plain.impedance_ns_per_m[at] == pytest.approx(expected, rel=0.03)
    assert damped.impedance_ns_per_m[at] == pytest.approx(expected + 1.74, rel=0.03)
    assert [trial.judged.verdict.answer for trial in found.trials if trial.judged] == [
        "passive",
        "passive",
    ]
    one, other = (trial.numbers for trial in found.trials)
    assert one["velocity_sd_m_per_s"] > other["velocity_sd_m_per_s"]
    assert all(
        numbers["work_j"] > 0.0 and numbers["diverged_at_s"] == inf for numbers in (one, other)
    )


def test_predicted_line_lies_on_the_measured_one() -> None:
    found = run_scene(plan_scene(scene(seconds=20.0, kbm=(100.0, 0.5, 0.002))))
    for trial in found.trials:
        assert trial.judged is not None
        assert trial.judged.predicted is not None
        z = trial.judged.measured
        inside = (z.frequency_hz > 5.0) & (z.frequency_hz < 500.0)
        assert np.allclose(z.impedance_ns_per_m[inside], trial.judged.predicted[inside], rtol=0.1)


def test_pushed_scene_has_traces_and_no_impedance() -> None:
    pushed = scene(seconds=0.5, kbm=(100.0, 3.0, 0.0), excitation=Excitation("push", force_n=0.5))
    trial = run_scene(plan_scene(pushed)).trials[0]
    position_m, force_n = trial.found.traces(0)
    assert (trial.judged, trial.winding_c) == (None, None)
    assert position_m[-1] == pytest.approx(0.5 / 100.0, rel=1e-3)
    assert force_n[-1] == pytest.approx(-0.5, rel=1e-3)
    assert len(position_m) == len(force_n) == 500
    assert len(trial.found.record(0)[1]) == 2000


@pytest.mark.slow
def test_hot_scene_tells_its_temperatures() -> None:
    found = run_scene(plan_scene(load_scene("hot"), seconds=6.0))
    for trial in found.trials:
        assert trial.winding_c is not None
        times, celsius = trial.winding_c
        assert (times[0], celsius[0], times[-1]) == (0.0, 20.0, 6.0)
        assert (np.diff(celsius) > 0.0).all()


def test_unstable_trial_is_reported_as_diverged() -> None:
    wild = scene(seconds=6.0, kbm=(60_000.0, 0.0, 0.0))
    trial = run_scene(plan_scene(wild)).trials[0]
    at_s, (position_m, _) = trial.numbers["diverged_at_s"], trial.found.traces(0)
    assert at_s < 6.0
    assert len(trial.found.record(0)[1]) == pytest.approx(4000 * at_s)
    assert len(position_m) == pytest.approx(1000 * at_s)
    assert np.isfinite(position_m).all()


# --- scenes ---------------------------------------------------------------------------------------


def test_only_scenes_without_nonlinearity_are_linear() -> None:
    assert is_linear(load_scene("theory"))
    assert not is_linear(load_scene("fig7"))
    assert not is_linear(replace(load_scene("theory"), environment=load_scene("wall").environment))


def test_frequencies_lie_on_the_grid_of_the_papers_window() -> None:
    f = frequencies((2.0, 500.0))
    assert np.allclose(f / (2000.0 / 2048), np.rint(f / (2000.0 / 2048)))
    assert (f[0] >= 2.0, f[-1] <= 500.0) == (True, True)
    assert (np.diff(f) > 0.0).all()
