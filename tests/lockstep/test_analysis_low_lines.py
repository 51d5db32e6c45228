"""A limit cycle or a hum between 2 and 12 Hz is named, and nothing else is: not the device's own
resonance, however narrow, not friction, counts or noise of the probe.
"""

import pytest
from support.analysis_low_lines import (
    DRY,
    HEAVY,
    RATE_HZ,
    named,
    trial_records,
    with_line,
)

from hapticd.core.arrays import Floats
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.store import TrialRecord
from hapticd.zwidth.trial import TrialParams, TrialResult, judged, plan_trial


@pytest.mark.parametrize("line_hz", [3.0, 5.0, 8.0])
def test_a_line_that_wanders_is_named(line_hz):
    for force, velocity in trial_records(HEAVY, 100.0, 2):
        (found,) = named(force, with_line(velocity, line_hz, 0.1, width_hz=0.1))
        assert found.code == "line"


@pytest.mark.parametrize("seconds", [5.0, 10.0, 20.0])
@pytest.mark.parametrize(("device", "stiffness"), [(HEAVY, 50.0), (DRY, 20.0), (DRY, 0.0)])
def test_a_short_record_has_lines_only_where_they_are(device, stiffness, seconds):
    for force, velocity in trial_records(device, stiffness, 8, seconds):
        assert named(force, velocity) == ()
        if seconds > 5.0:
            (found,) = named(force, with_line(velocity, 5.0, 0.25))
            assert found.code == "line"


def of_trial(velocity: Floats, force: Floats) -> TrialResult:
    plan = plan_trial(TrialParams(Trial((20.0, 0.0, 0.0), seconds=90.0), DRY))
    return judged(plan, TrialRecord(force, velocity, RATE_HZ, "test", True))


def test_a_verdict_names_it_and_calls_a_strong_one_unstable():
    ((force, velocity),) = trial_records(DRY, 20.0, 1)
    assert of_trial(velocity, force).verdict.stability == "stable"
    weak = of_trial(with_line(velocity, 5.0, 0.1), force).verdict
    assert "line at 5" in str(weak)
    assert weak.stability == "stable"
    strong = of_trial(with_line(velocity, 5.0, 0.6), force).verdict
    assert "oscillation at 5" in str(strong)
    assert strong.answer == "not_passive"
