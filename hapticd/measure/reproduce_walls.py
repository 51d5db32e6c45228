"""Fig. 2: the largest stiffness of a virtual wall that an impact does not set oscillating, for each virtual damping.

The device hits the wall at 0.1 m/s and is pushed against it with 0.5 N; the wall is stable if after 1.5 s nothing moves faster than
2 mm/s. The paper does not say how its walls were hit; only the shape can be compared.
"""

from dataclasses import replace
from functools import cache

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.plant.compose import compose
from hapticd.plant.model import Model
from hapticd.plant.scene import Scene
from hapticd.settings.scene import load_scene
from hapticd.sim.engine import simulate

SCENE = "wall"
DAMPINGS = np.array([0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0])
STIFFNESSES = np.geomspace(20.0, 3000.0, 22)
FINER = 5
AFTER_S = 1.5
STILL_M_PER_S = 2e-3


def highest_wall(level: float, damping: float) -> float:
    """Largest stable stiffness [N/m] below the first that is not; 0 if none is."""
    coarse = _last_stable(level, damping, STIFFNESSES)
    if not 0.0 <= coarse < len(STIFFNESSES) - 1:
        return float(STIFFNESSES[-1]) if coarse >= 0 else 0.0
    finer = np.geomspace(STIFFNESSES[coarse], STIFFNESSES[coarse + 1], FINER + 1)
    return float(finer[max(0, _last_stable(level, damping, finer))])


def _last_stable(level: float, damping: float, stiffnesses: Floats) -> int:
    for place, stiffness in enumerate(stiffnesses):
        if not stable(level, damping, float(stiffness)):
            return place - 1
    return len(stiffnesses) - 1


@cache
def _device() -> tuple[Scene, Model]:
    scene = load_scene(SCENE)
    return scene, compose(scene)


def stable(level: float, damping: float, stiffness: float) -> bool:
    """Whether the wall comes to rest at that electrical damping [N s/m]."""
    scene, model = _device()
    wall = replace(scene.environment.wall, stiffness_n_per_m=stiffness, damping_ns_per_m=damping)
    found = simulate(
        model, [[0.0, 0.0, 0.0]], scene.seconds, damping=level, environment=replace(scene.environment, wall=wall),
        excitation=scene.excitation, start=(scene.start_position_m, scene.start_velocity_m_per_s), keep="records",
    )  # fmt: skip
    _, velocity = found.record(0)
    late = velocity[int(AFTER_S * found.rate_hz) :]
    return bool(not found.diverged[0] and np.abs(late).max(initial=0.0) < STILL_M_PER_S)
