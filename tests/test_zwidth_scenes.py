"""Scenes as the bench takes them: which are linear, and at which frequencies they are judged."""

from dataclasses import replace

import numpy as np

from hapticd.settings.scene import load_scene
from hapticd.zwidth.scenes import frequencies, is_linear


def test_only_scenes_without_nonlinearity_are_linear() -> None:
    assert is_linear(load_scene("theory"))
    assert not is_linear(load_scene("fig7"))
    assert not is_linear(replace(load_scene("theory"), environment=load_scene("wall").environment))


def test_frequencies_lie_on_the_grid_of_the_papers_window() -> None:
    f = frequencies((2.0, 500.0))
    assert np.allclose(f / (2000.0 / 2048), np.rint(f / (2000.0 / 2048)))
    assert (f[0] >= 2.0, f[-1] <= 500.0) == (True, True)
    assert (np.diff(f) > 0.0).all()
