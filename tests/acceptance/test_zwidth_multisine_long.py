"""Trials by multisines: realisations that repeat, their scatter, and the whole stack beside the
engine.
"""

import numpy as np
import pytest
from support.measured_scenes import RIGID
from test_zwidth_multisine import shaken

from hapticd.run.lockstep import LockStepClient, scene_params
from hapticd.settings.scene import load_scene
from hapticd.zwidth.live import daemon_source
from hapticd.zwidth.simulated import engine_source
from hapticd.zwidth.trial import (
    MultisineLayout,
    run_trial,
)


@pytest.fixture
def rigid(tmp_path):
    path = tmp_path / "rigid.toml"
    path.write_text(RIGID)
    return path


def test_multisine_trial_by_the_whole_stack_lands_within_its_interval_of_the_engine(rigid):
    scene = load_scene(rigid)
    layout = MultisineLayout(6, 2)
    by_engine = run_trial(shaken(layout, scene=scene), engine_source(scene))
    with LockStepClient(*scene_params(rigid)) as bench:
        live = run_trial(shaken(layout, scene=scene), daemon_source(bench))
        assert bench.status().state == "disabled"
    assert live.verdict.answer == by_engine.verdict.answer == "passive"
    assert live.recorded.more["lost_samples"] == 0
    inside = (live.measured.frequency_hz >= 2.0) & (live.measured.frequency_hz <= 500.0)
    ratio = live.measured.impedance_ns_per_m[inside] / by_engine.measured.impedance_ns_per_m[inside]
    assert np.sqrt(np.mean(np.abs(ratio - 1.0) ** 2)) < 3e-3
    assert (
        live.verdict.margin_ns_per_m.lower
        <= by_engine.verdict.margin_ns_per_m.value
        <= live.verdict.margin_ns_per_m.upper
    )
