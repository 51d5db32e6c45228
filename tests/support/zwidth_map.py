"""Many trials on the simulator: axis limits, maps, the directed search, virtual walls, portable
summaries.
"""

from hapticd.settings.scene import load_scene
from hapticd.zwidth.outcomes import (
    Conditions,
)

THEORY = load_scene(
    "theory"
)  # rigid, 8 g, b = 1 N s/m, 1 kHz, no delay: K is passive up to 2 b / T = 2,000 N/m


def conditions(scene=THEORY, seconds=20.0):
    return Conditions(scene, seconds, scene.noise)
