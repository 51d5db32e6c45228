"""The directed search beside the grid: on a rigid display without friction theory knows every
answer.
"""

from dataclasses import replace

import numpy as np
import pytest

from examples.weir2008 import future_work
from examples.weir2008.future_work import SearchCheck, compared_with_grid
from hapticd.settings.scene import load_scene
from hapticd.zwidth.map import MapParams, plan_map
from hapticd.zwidth.outcomes import Conditions
from hapticd.zwidth.passive_set import grid

AXES = (np.linspace(0.0, 2100.0, 7), np.linspace(0.0, 1.9, 6), np.linspace(-0.002, 0.003, 6))


@pytest.fixture(scope="module")
def conditions():
    scene = load_scene("theory")
    return Conditions(scene, 30.0, scene.noise)


@pytest.fixture(scope="module")
def found(conditions):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(future_work, "SEARCHED", {0.0: AXES})
        return compared_with_grid(conditions, 0.0, budgets=(6, 12))


def test_truth_is_the_grid_that_theory_gives(conditions, found):
    theory = plan_map(MapParams(conditions, AXES, (0.0,))).levels[0].prediction.passive
    assert found.points == len(grid(AXES))
    assert (
        abs(found.passive - theory.sum()) <= 1.5 * found.other_noise
    )  # single trials doubt what lies on the boundary


def test_grid_with_other_noise_and_prediction_leave_no_point_wrong(found):
    """Without friction all that noise could hide is resolved by the records."""
    assert found.other_noise == 0
    assert found.predicted == 0


def test_search_is_wrong_on_few_points_of_the_boundary_alone(found):
    assert set(found.searched) == {6, 12}
    assert len(found.found.steps) == 12
    assert found.passive > 60
    assert found.searched[12] <= 0.03 * found.passive


def test_search_has_noise_of_its_own(conditions, found):
    asked = found.found.plan.params.conditions
    assert asked.excitation.seed == future_work.SEARCH_SEED
    assert asked == replace(conditions, excitation=asked.excitation)
    assert future_work.SEARCH_SEED not in future_work.GRID_SEEDS


@pytest.mark.parametrize(
    ("wrong", "enough"), [({20: 5, 40: 3}, 20), ({20: 9, 40: 5}, 40), ({20: 9, 40: 6}, None)]
)
def test_enough_is_the_first_budget_not_above_the_floor(found, wrong, enough):
    assert SearchCheck(0.0, 100, 50, 8, 5, wrong, found.found).enough == enough


def test_share_is_of_the_passive_points(found):
    assert replace(found, passive=50).share(4) == 8.0
