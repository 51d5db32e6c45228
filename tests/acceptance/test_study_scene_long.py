"""A scene by itself: ceilings of damping, runs with damping and without, and explicit methods, each
against a closed form.
"""

import numpy as np
import pytest

from hapticd.settings.scene import load_scene
from hapticd.studies.scene import plan_scene, run_scene


@pytest.mark.slow
def test_hot_scene_tells_its_temperatures() -> None:
    found = run_scene(plan_scene(load_scene("hot"), seconds=6.0))
    for trial in found.trials:
        assert trial.winding_c is not None
        times, celsius = trial.winding_c
        assert (times[0], celsius[0], times[-1]) == (0.0, 20.0, 6.0)
        assert (np.diff(celsius) > 0.0).all()
