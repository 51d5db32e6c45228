"""What a device withstands, against closed forms and the rest of the analysis."""

import numpy as np
import pytest
from support.guard_device import change, shipped_judge

from hapticd.model.compose import compose
from hapticd.model.theorem import (
    circles,
    lifted_margin,
    lifted_system,
    outside_circles,
)
from hapticd.zwidth.sources import device_scene


@pytest.mark.parametrize("level", [0.0, 1.74])
@pytest.mark.parametrize("spare", [-0.3, 0.0, 0.2])
def test_yes_or_no_agrees_with_the_margin(level: float, spare: float) -> None:
    """The circles of many points at once against forty halvings for each."""
    scene = device_scene("weir2008")
    assert scene is not None
    lifted = lifted_system(compose(scene), level)
    draw = np.random.default_rng(2)
    high = (500.0, 4.0, 0.03) if level else (100.0, 1.0, 0.004)  # damping enlarges the set
    points = draw.uniform((0.0, -0.5 * high[1], -0.5 * high[2]), high, (400, 3))
    margins = lifted_margin(lifted, points)
    flags = outside_circles(circles(lifted, spare), points)
    assert 5 < flags.sum() < 395
    np.testing.assert_array_equal(flags, margins >= spare)


def test_negative_stiffness_is_refused() -> None:
    """The example of a passive-looking point that is unstable: K = -34, B = -0.86, M = 0.0048."""
    answer = change(shipped_judge(), {"K": -34.0, "B": -0.86, "M": 0.0048})
    assert answer["action"] == "refuse"
    assert "K < 0" in answer["verdict"]["text"]
