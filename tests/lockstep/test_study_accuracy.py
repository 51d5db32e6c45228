"""What accuracy costs: the knee, both comparisons against closed forms, and trials in lock-step."""

from math import inf, nan

import pytest
from support.measured_scenes import stopwatch
from support.study_accuracy import row

from hapticd.core.errors import AnalysisError
from hapticd.settings.scene import load_scene
from hapticd.studies.accuracy import PositionComparison, Setting, cheapest_near_best, mark_knees


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


@pytest.mark.slow
def test_lockstep_flies_a_push_as_the_engine_does() -> None:
    toggle = load_scene("toggle")
    comparison = PositionComparison(toggle, "toggle", Setting(3.0, 4), stopwatch())
    found = comparison.lockstep(3.0)
    assert found.step < 1.0  # um; two counts, after damping has been switched
    assert found.seconds == pytest.approx(1e-3)


def test_lockstep_refuses_a_scene_that_begins_in_motion() -> None:
    comparison = PositionComparison(load_scene("wall"), "wall", Setting(1.0), stopwatch())
    with pytest.raises(AnalysisError, match="starts in motion, but lock-step starts at rest"):
        comparison.lockstep(1.0)
