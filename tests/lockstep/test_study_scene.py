"""A scene by itself: ceilings of damping, runs with damping and without, and explicit methods, each
against a closed form.
"""

from dataclasses import replace
from math import exp, inf

import numpy as np
import pytest
from support.measured_scenes import MASS_KG, PARTS, VISCOUS_NS_PER_M, scene

from hapticd.core.errors import ConfigError
from hapticd.model.effects import Crowbar
from hapticd.model.scene import DampingStep, Excitation
from hapticd.settings.scene import load_scene
from hapticd.studies.scene import ceiling, compare_integrators, plan_scene, run_scene


def test_shorted_motor_has_no_ceiling() -> None:
    with pytest.raises(
        ConfigError, match="the motor is shorted and obeys no damping command; leave out 'crowbar'"
    ):
        ceiling(scene((*PARTS, Crowbar())))


def test_undamped_scene_is_compared_with_damping_on() -> None:
    plan = plan_scene(scene(seconds=10.0))
    assert [case.active_damping for case in plan.cases] == [((0.0, 0.0),), ((0.0, 1.74),)]
    assert [case.own for case in plan.cases] == [True, False]
    assert plan.impedance


def test_switched_scene_keeps_its_steps() -> None:
    steps = (DampingStep(0.0, 0.0), DampingStep(2.0, 3.0), DampingStep(4.0, 0.0))
    plan = plan_scene(replace(scene(seconds=10.0), active_damping=steps), seconds=1.0)
    assert plan.cases[1].active_damping == ((0.0, 0.0), (2.0, 3.0), (4.0, 0.0))
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


def test_unstable_trial_is_reported_as_diverged() -> None:
    wild = scene(seconds=6.0, kbm=(60_000.0, 0.0, 0.0))
    trial = run_scene(plan_scene(wild)).trials[0]
    at_s, (position_m, _) = trial.numbers["diverged_at_s"], trial.found.traces(0)
    assert at_s < 6.0
    assert len(trial.found.record(0)[1]) == pytest.approx(4000 * at_s)
    assert len(position_m) == pytest.approx(1000 * at_s)
    assert np.isfinite(position_m).all()


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
    found = compare_integrators(scene().without("viscous"))
    assert set(found.longest_s.values()) == {inf}
    assert found.fastest_s == inf
    assert found.error["euler"].max() < 1e-9
