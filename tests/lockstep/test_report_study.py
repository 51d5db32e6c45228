"""Figures: what is drawn is what was measured, labelled with units; the same data give the same
bytes.
"""

import sys
from dataclasses import replace
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.measured_scenes import noisy_scene, scene

from hapticd.core.errors import ConfigError, MissingLibrary
from hapticd.model.scene import Excitation
from hapticd.studies.accuracy import AccuracyResult, AccuracyRow, plan_accuracy
from hapticd.studies.effects import EffectsParams, EffectsResult, LeftOut, plan_effects
from hapticd.studies.report import impedance_rows, integrators_figure, scene_figure, scene_table
from hapticd.studies.report_methods import (
    accuracy_figure,
    accuracy_table,
    accuracy_words,
    effects_figure,
    effects_table,
    effects_words,
)
from hapticd.studies.scene import SceneResult, compare_integrators, plan_scene, run_scene
from hapticd.zwidth.report import style
from hapticd.zwidth.report.paper import text


@pytest.fixture(scope="module")
def noisy() -> SceneResult:
    return noisy_scene()


def labels(figure: Any) -> list[tuple[str, str]]:
    return [(axis.get_xlabel(), axis.get_ylabel()) for axis in figure.axes]


def written(figure: Any) -> set[str]:
    """All words in a figure."""
    return {
        found.get_text()
        for found in figure.findobj(lambda item: hasattr(item, "get_text"))
        if found.get_text()
    }


# --- files ----------------------------------------------------------------------------------------


def test_folder_that_cannot_be_written_is_named(tmp_path: Path, noisy: SceneResult) -> None:
    blocker = tmp_path / "file"
    blocker.touch()
    with pytest.raises(
        ConfigError, match=f"{blocker}: .*; name a folder that you may write to with --out"
    ):
        style.save(scene_figure(noisy), blocker, "x")


def test_missing_matplotlib_is_told_with_its_remedy(
    monkeypatch: pytest.MonkeyPatch, noisy: SceneResult
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingLibrary) as missing:
        scene_figure(noisy)
    assert missing.value.requirement.startswith("matplotlib>=")


# --- scenes ---------------------------------------------------------------------------------------


def test_axes_of_a_noisy_scene_have_units(noisy: SceneResult) -> None:
    assert labels(scene_figure(noisy)) == [
        ("time (s)", "position (mm)"),
        ("frequency (Hz)", "|Z| (N s/m)"),
        ("time (s)", "virtual force (N)"),
        ("frequency (Hz)", "phase of Z (degrees)"),
    ]


def test_legend_tells_both_trials_and_the_prediction(noisy: SceneResult) -> None:
    figure = scene_figure(noisy)
    assert {item.get_text() for item in figure.legends[0].get_texts()} == {
        "no active damping",
        "active damping 1.74 N s/m",
        "predicted",
    }


def test_measured_line_is_what_was_measured(noisy: SceneResult) -> None:
    size = scene_figure(noisy).axes[1]
    drawn = next(line for line in size.lines if line.get_label() == "no active damping")
    assert noisy.trials[0].judged is not None
    z = noisy.trials[0].judged.measured
    shown = (z.frequency_hz >= 1.9) & (z.frequency_hz <= 1000.0)
    assert np.array_equal(drawn.get_ydata(), np.abs(z.impedance_ns_per_m[shown]))


def test_pushed_scene_shows_position_force_and_damping() -> None:
    pushed = scene(seconds=0.3, kbm=(100.0, 3.0, 0.0), excitation=Excitation("push", force_n=0.5))
    figure = scene_figure(run_scene(plan_scene(pushed)))
    assert [label for _, label in labels(figure)] == [
        "position (mm)",
        "virtual force (N)",
        "active damping (N s/m)",
    ]
    assert figure.axes[-1].get_xlabel() == "time (s)"


def test_scene_says_that_it_is_simulated_and_what_it_renders(noisy: SceneResult) -> None:
    assert "a small scene: K = 100 N/m, B = 0.5 N s/m, M = 0 g  (simulated none)" in written(
        scene_figure(noisy)
    )


def test_scene_table_marks_its_own_trial_and_its_verdict(noisy: SceneResult) -> None:
    lines = text(scene_table(noisy)).splitlines()
    assert lines[0].split("  ")[0] == "trial"
    assert "no active damping (the scene)" in lines[2]
    assert "passive" in lines[2]
    assert "ran to its end" in lines[3]


def test_divergence_is_in_the_table(noisy: SceneResult) -> None:
    wild = replace(
        noisy,
        trials=(
            replace(
                noisy.trials[0],
                found=replace(noisy.trials[0].found, samples=np.array([5000])),
                judged=None,
            ),
            noisy.trials[1],
        ),
    )
    assert "diverged at 1.25 s" in text(scene_table(wild))


def test_impedance_rows_are_those_of_the_trial(noisy: SceneResult) -> None:
    rows = impedance_rows(noisy.trials[0])
    assert rows[0]["frequency_hz"] >= 2.0
    assert rows[10]["impedance_ns_per_m"] == pytest.approx(rows[10]["predicted_ns_per_m"], rel=0.3)
    assert impedance_rows(replace(noisy.trials[0], judged=None)) == []


# --- effects --------------------------------------------------------------------------------------


@pytest.fixture
def judged() -> EffectsResult:
    plan = plan_effects(EffectsParams(scene(), "limits"))
    whole = (
        LeftOut("", "predicted", {"K N/m": 100.0}, 0.0, 2e-5),
        LeftOut("", "simulated", {"K N/m": 95.0}, 0.0, 2e-5),
    )
    rows = (
        LeftOut("smoothing", "predicted", {"K N/m": 500.0}, 4.0, 2e-5),
        LeftOut("lag", "predicted", {}, inf, nan, "needs a lag"),
        LeftOut("coulomb", "simulated", {"K N/m": 60.0}, 0.4, 2e-5),
        LeftOut("encoder", "simulated", {"K N/m": 95.0}, 1e-9, 1e-5),
    )
    proposal = LeftOut("", "simulated", {"K N/m": 95.5}, 0.005, 1e-5)
    return EffectsResult(plan, whole, rows, ("viscous",), proposal)


def test_every_effect_has_a_bar_with_its_change(judged: EffectsResult) -> None:
    figure = effects_figure(judged)
    axis = figure.axes[0]
    assert [label.get_text() for label in axis.get_yticklabels()] == [
        "encoder",
        "coulomb",
        "lag",
        "smoothing",
    ]
    assert {"400 %", "40 %", "0 %", "cannot be left out", "tolerance 2 %"} <= written(figure)
    assert axis.get_xlabel() == "change of limits when left out"
    assert len(axis.patches) == 4


def test_effects_table_has_method_and_cost(judged: EffectsResult) -> None:
    lines = text(effects_table(judged)).splitlines()
    assert lines[0].split()[:4] == ["scene", "K", "N/m", "change"]
    assert "needs a lag" in lines[5]
    assert lines[-1].split() == ["proposal", "95.5", "0.5", "%", "simulated", "10", "us"]


def test_proposal_is_said_in_a_sentence(judged: EffectsResult) -> None:
    all_kept = replace(judged, kept=("viscous",))
    assert effects_words(all_kept) == "Every effect changes limits by more than 2 %: keep them all."
    words = effects_words(replace(judged, kept=()))
    assert words.startswith(
        "For limits within 2 % keep none. Without viscous the answer changes by 0.5 % together"
    )
    assert words.endswith("a simulated second costs 10 us instead of 20 us.")


def test_scene_without_limits_is_told(judged: EffectsResult) -> None:
    none = replace(judged.whole[0], numbers={"K N/m": nan})
    assert "not passive already, so it has no limits" in effects_words(
        replace(judged, whole=(none, judged.whole[1]))
    )


# --- accuracy -------------------------------------------------------------------------------------


@pytest.fixture
def swept() -> AccuracyResult:
    plan = plan_accuracy(scene(seconds=90.0), "small")
    rows = (
        AccuracyRow("tier", "predict, alone", 0.007, 0.5, 0.5),
        AccuracyRow("tier", "simulate", 0.01, 0.09, 0.4, default=True, knee=True),
        AccuracyRow("tier", "lock-step", nan, inf, inf, note="begins in motion"),
        AccuracyRow("sub-steps", "1", 0.008, 0.5, 0.6),
        AccuracyRow("sub-steps", "4", 0.01, 0.09, 0.4, default=True, knee=True),
        AccuracyRow("sub-steps", "32", 0.02, nan, nan, note="the reference"),
        AccuracyRow("precision", "f32, 4", 0.009, 0.09, 0.4, knee=True, dtype="f32"),
        AccuracyRow("trial length", "5 s", 0.002, nan, 1.6),
        AccuracyRow("trial length", "90 s", 0.01, 0.09, 0.4, default=True, knee=True),
        AccuracyRow("window", "2048", 0.01, 0.09, 0.4, default=True, knee=True),
        AccuracyRow("effect", "coulomb", 0.009, 9.0, 9.0),
        AccuracyRow("effect", "viscous", nan, inf, inf, note="not stable"),
    )
    return AccuracyResult(plan, "deg", "phase of Z", "a long run", rows)


def test_every_sweep_has_its_panel_with_units(swept: AccuracyResult) -> None:
    figure = accuracy_figure(swept)
    assert [axis.get_title(loc="left") for axis in figure.axes] == [
        "ways to simulate",
        "sub-steps per 4 kHz sample",
        "effects, each left out",
        "length of the trial",
        "window of the spectra, samples",
    ]
    assert {label for _, label in labels(figure)} == {"error (deg)", ""}
    assert {
        "defaults",
        "the cheapest setting within 10 % of the best",
        "cannot be left out",
        "9",
    } <= written(figure)


def test_points_are_seconds_and_total_errors(swept: AccuracyResult) -> None:
    panel = accuracy_figure(swept).axes[1]
    line = next(
        found
        for found in panel.lines
        if found.get_linestyle() == "-" and len(found.get_xdata()) == 2
    )
    assert list(line.get_xdata()) == [0.008, 0.01]
    assert list(line.get_ydata()) == [0.6, 0.4]


def test_accuracy_table_marks_default_cheapest_and_reference(swept: AccuracyResult) -> None:
    lines = text(accuracy_table(swept)).splitlines()
    assert lines[0].endswith("total error deg")
    assert lines[6].endswith("default, cheapest setting within 10 % of the best")
    assert lines[7].endswith("the reference")
    assert lines[4].endswith("begins in motion")


def test_words_say_what_the_defaults_buy(swept: AccuracyResult) -> None:
    words = accuracy_words(swept)
    assert (
        words[1]
        == "The defaults (90 s, 4 sub-steps, f64, window 2048) cost 10 ms and leave 0.4 deg, 0.09"
        " deg of it by the sub-step."
    )
    assert (
        "trial length: the cheapest setting within 10 % of the best is 90 s (10 ms, 0.4 deg); the"
        " error still falls as 1/sqrt(length), a longer trial would buy more." in words
    )
    assert (
        "tier: the cheapest setting within 10 % of the best is simulate (10 ms, 0.4 deg)." in words
    )


def test_scene_without_noise_has_three_panels(swept: AccuracyResult) -> None:
    plan = plan_accuracy(scene(excitation=Excitation("push", force_n=1.0)), "small")
    figure = accuracy_figure(replace(swept, plan=plan, unit="um"))
    assert len(figure.axes) == 3


def test_explicit_methods_are_drawn_with_their_limits() -> None:
    found = compare_integrators(scene())
    figure = integrators_figure(found, "a small scene")
    assert labels(figure) == [("steps per millisecond", "relative error after 20 ms")]
    names = {item.get_text() for item in figure.axes[0].get_legend().get_texts()}
    assert names == {
        "exact map: stable at any step",
        "Runge-Kutta 4: stable below 22.3 ms",
        "explicit Euler: stable below 16 ms",
    }
