"""`rig motor --spring` and `--offset` at rigs whose gain and offset are others than the file's."""

import numpy as np
import pytest
from support.models import COUNT_N, device_params
from support.rig_hand import Hand
from support.rig_spring import SPRING

from hapticd.core.errors import AnalysisError
from hapticd.core.params import to_plain
from hapticd.rig.steps.motor import Spring, analyse_spring, measure_spring

DEVICE = to_plain(device_params())  # up to 8 N


def test_a_spring_waits_for_the_signs():
    with Hand({"commissioning": True}) as hand, pytest.raises(AnalysisError, match="signs"):
        measure_spring(hand.bench, lambda request: None, SPRING)


def rests(scale=1.0, k=300.0, friction_n=0.03, bent=0.0):
    """Ways up and down to either side, of a spring whose stiffness may grow as it is stretched."""
    found = []
    for force in (0.4, 0.8, 1.2, -0.4, -0.8, -1.2):
        places = [(scale * force - way * np.sign(force) * friction_n) / k for way in (1.0, -1.0)]
        found.append([(force, x * (1.0 - bent * abs(force))) for x in places])
    return np.array(found)


def test_a_spring_that_ends_is_refused():
    result = analyse_spring(rests(bent=0.3), SPRING, DEVICE)
    assert not result.settled
    assert not result.changes
    assert "buckle" in result.findings[0].remedy


def test_a_spring_typed_ten_times_wrong_is_refused():
    result = analyse_spring(rests(), Spring(3000.0), DEVICE)
    assert not result.settled


def test_a_weaker_motor_lowers_the_limit_of_the_device():
    result = analyse_spring(rests(scale=0.9), SPRING, DEVICE)
    changes = {(one.table, one.key): one.value for one in result.changes}
    assert changes["force", "full_scale_n"] == pytest.approx(0.9 * 32767 * COUNT_N, rel=1e-3)
    assert 7.1 < changes["limits", "force_n"] <= 7.2
