"""The map that takes a laboratory 13 days: 6,384 environments, undamped and damped, by prediction alone. Wall clock."""

import statistics
import time
from collections.abc import Iterator

import numpy as np

from benchmarks.figures import Figure, compared
from hapticd.analysis.boundary import grid
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.predict import predict
from hapticd.plant.compose import compose
from hapticd.settings.scene import load_scene

TARGETS = {"predict_map_s": "<= 1"}
AXES = (np.linspace(0.0, 1100.0, 12), np.linspace(-1.0, 8.0, 19), np.linspace(-0.024, 0.03, 28))
LEVELS_NS_PER_M = (0.0, 1.74)
SCENE = "fig7"
ROUNDS = 5


def measure() -> Iterator[Figure]:
    """Seconds for both levels, the median of a few rounds; linearised friction, stability and margin of every environment."""
    model, points = compose(load_scene(SCENE)), grid(AXES)
    assert len(points) == 6384
    taken = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        for level in LEVELS_NS_PER_M:
            predict(model, points, level, perturbation=Perturbation())
        taken.append(time.perf_counter() - begin)
    yield compared("predict_map_s", TARGETS["predict_map_s"], statistics.median(taken), "s")
