"""What a column of times says: the rate of the step, which rows are missing, and in which unit
it may be.
"""

import numpy as np
import pytest

from hapticd.settings.scene import load_scene
from hapticd.zwidth.recorded import read_file
from hapticd.zwidth.simulated import engine_source
from hapticd.zwidth.sources import Trial, file_source
from hapticd.zwidth.trial import TrialParams, judged, plan_trial


@pytest.fixture(scope="module")
def passive():
    """90 s of fig. 4 by the engine."""
    return engine_source(load_scene("fig4"))(TRIAL, lambda *_: None)


TRIAL = Trial((100.0, 1.0, 0.010), seconds=90.0)


def verdict_of(path):
    return judged(
        plan_trial(TrialParams(TRIAL)), file_source(read_file(path))(TRIAL, lambda *_: None)
    ).verdict


def test_rows_missing_singly_do_not_move_the_margin_and_are_named(passive, tmp_path):
    """Closed up and taken at the mean rate, 1 % cost three quarters of a N s/m."""
    count = passive.force_n.size
    margins = {}
    for share in (0.0, 0.005, 0.03):
        rows = np.flatnonzero(np.random.default_rng(4).random(count) >= share)
        channels = {"force": passive.force_n[rows], "velocity": passive.velocity_m_per_s[rows]}
        np.savez(tmp_path / "a.npz", **channels, time_s=rows / 4000.0)
        found = margins[share] = verdict_of(tmp_path / "a.npz")
        lost = rows[-1] + 1 - rows[0] - rows.size
        assert (f"samples of the probe lost: {lost} of {rows[-1] - rows[0] + 1}" in str(found)) == (
            share > 0.0
        )
    assert margins[0.005].margin_ns_per_m.value == pytest.approx(
        margins[0.0].margin_ns_per_m.value, abs=0.03
    )
    assert margins[0.0].answer == margins[0.005].answer == "passive"
    assert margins[0.03].answer == "undecided"
    assert "rows are missing by the times in the file, record again without gaps" in str(
        margins[0.03]
    )
