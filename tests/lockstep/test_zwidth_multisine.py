"""Trials by multisines: realisations that repeat, their scatter, and the whole stack beside the
engine.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.measured_scenes import RIGID

from hapticd.core.errors import AnalysisError
from hapticd.model.scene import Excitation
from hapticd.settings.scene import load_scene
from hapticd.signal.assess import Criteria
from hapticd.zwidth.recorded import read_file
from hapticd.zwidth.simulated import engine_source
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.store import read_summary, record_path
from hapticd.zwidth.trial import (
    MultisineLayout,
    TrialParams,
    judged,
    multisine_like,
    plan_trial,
    run_trial,
    write,
)


@pytest.fixture
def rigid(tmp_path):
    path = tmp_path / "rigid.toml"
    path.write_text(RIGID)
    return path


def shaken(layout, point=(100.0, 1.0, 0.002), scene=None, **more):
    """The plan of a trial by multisines."""
    trial = Trial(point, excitation=multisine_like(Excitation("noise"), 500.0), **more)
    return plan_trial(TrialParams(trial, scene, Criteria(estimator="h_force"), multisine=layout))


def test_multisine_trial_lands_on_its_prediction(rigid):
    """A linear display: 12 s decide, and Z is known to 1e-3 up to 200 Hz."""
    scene = load_scene(rigid)
    found = run_trial(shaken(MultisineLayout(6, 1), scene=scene), engine_source(scene))
    assert found.verdict.answer == "passive"
    assert found.recorded.seconds == pytest.approx(6 * 2 * 4096 / 4000)
    inside = (found.measured.frequency_hz >= 2.0) & (found.measured.frequency_hz <= 200.0)
    assert (
        np.abs(found.measured.impedance_ns_per_m[inside] / found.predicted[inside] - 1.0).max()
        < 1e-3
    )
    assert (
        found.spectra.covers
        == "noise and nonlinear distortion at this perturbation, from the scatter of 6 realisations"
        " of 1 periods"
    )


def test_multisine_of_friction_says_that_only_realisations_help():
    scene = load_scene("fig7")
    found = run_trial(shaken(MultisineLayout(8, 2), (50.0, 2.0, 0.0), scene), engine_source(scene))
    assert "nonlinear distortion: realisations scatter by" in str(found.verdict)
    assert found.verdict.answer == "undecided"


def test_single_realisation_decides_nothing(rigid):
    scene = load_scene(rigid)
    found = run_trial(shaken(MultisineLayout(1, 4), scene=scene), engine_source(scene))
    assert found.verdict.answer == "undecided"
    assert "one realisation: the interval covers noise alone" in str(found.verdict)


def stalling(source, stalls):
    """`source` whose first records are those of a host that let the board run out of samples
    for 4 ms.
    """
    left = [stalls]

    def record(trial, tell):
        found = source(trial, tell)
        left[0] -= 1
        return (
            replace(found, force_n=np.insert(found.force_n[:-16], 5000, np.zeros(16)))
            if left[0] >= 0
            else found
        )

    return record


def test_realisation_that_did_not_repeat_is_flown_again(rigid):
    engine = engine_source(load_scene(rigid))
    plan = shaken(MultisineLayout(3, 1))
    found, calm = (run_trial(plan, stalling(engine, stalls)) for stalls in (2, 0))
    assert found.recorded.more["flown_again"] == 2
    assert np.array_equal(found.recorded.force_n, calm.recorded.force_n)
    with pytest.raises(
        AnalysisError,
        match=(
            "the force did not repeat in 8 tries of a realisation: the host stalls for milliseconds"
        ),
    ):
        run_trial(plan, stalling(engine, 8))


def test_layouts_without_scatter_are_refused():
    with pytest.raises(
        AnalysisError,
        match="1 realisations of 1 periods have no scatter to learn from; ask for two or more",
    ):
        shaken(MultisineLayout(1, 1))
    with pytest.raises(AnalysisError, match="8 realisations of 0 periods have no scatter"):
        shaken(MultisineLayout(8, 0))


def test_multisine_of_a_runaway_loop_is_no_verdict_but_an_answer(rigid):
    scene = load_scene(rigid)
    with pytest.raises(
        AnalysisError, match=r"ended after \S+ s \(escape: .*\): too short for a verdict"
    ):
        run_trial(shaken(MultisineLayout(4, 1), (0.0, 100.0, 0.0), scene), engine_source(scene))


def test_multisine_run_folder_brings_the_trial_back(tmp_path, rigid):
    scene = load_scene(rigid)
    layout = MultisineLayout(4, 1)
    result = run_trial(shaken(layout, scene=scene), engine_source(scene))
    write(tmp_path, result, {})
    told = read_summary(tmp_path)
    assert told["multisine"]["realisations"] == 4
    assert told["multisine"]["period_samples"] == 4096
    assert told["multisine"]["scatter_between_periods"] is None
    assert 0.0 < told["multisine"]["scatter_between_realisations"] < 0.01
    assert told["interval_covers"].startswith("noise and nonlinear distortion")
    again = judged(shaken(layout), read_file(record_path(tmp_path)))
    assert again.verdict.margin_deg.value == pytest.approx(
        result.verdict.margin_deg.value, abs=1e-2
    )
    with pytest.raises(
        AnalysisError,
        match=r"record of 8\.19 s: a realisation of 1 \+ 9 periods of 4096 samples takes 10\.2 s",
    ):
        judged(shaken(MultisineLayout(2, 9)), read_file(record_path(tmp_path)))
