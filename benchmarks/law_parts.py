"""A tick of the law with a part of `zwidth.engine.parts`, in CPython on recorded positions. CPU
time of its thread.

The yardstick is the law without a part on the same positions, in turns, minimum of the rounds of
each. The time of FOAW depends on the motion. Its window is longest at rest, so it is also timed
there.
"""

import time
from collections.abc import Iterator

import numpy as np

from benchmarks import targets
from benchmarks.figures import Figure, compared
from hapticd.core.arrays import Floats
from hapticd.core.units import NS_PER_US
from hapticd.model.scene import Scene
from hapticd.settings.scene import load_scene
from hapticd.studies.port_energy import played
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.engine.parts import WINDOW, LawPart
from hapticd.zwidth.sources import display

TARGETS = targets.of("law_parts")
ROUNDS = 9
SCENE = "fig4"
SECONDS = 2.0  # of the scene's own trial: 2,000 ticks
ASKED = (100.0, 1.0)  # K, B


def parts(count_m: float, rate_hz: float) -> dict[str, LawPart]:
    """Return the parts by the names of their figures."""
    return {
        "law_foaw": LawPart.foaw(count_m, rate_hz),
        "law_levant": LawPart.levant(100.0, rate_hz),
        "law_popc": LawPart.observer(),
        "law_popc_held": LawPart.held_observer(),
        "law_popc_window": LawPart.observer(WINDOW),
        "law_tank": LawPart.tank(1e-3, 0.1, rate_hz),
    }


def spent_us(scene: Scene, given: tuple[LawPart, ...], positions_m: Floats) -> float:
    """Return the time of a tick [us]."""
    begin = time.thread_time_ns()
    played(scene, given, ASKED, positions_m)
    return (time.thread_time_ns() - begin) / positions_m.size / NS_PER_US


def measure() -> Iterator[Figure]:
    """Yield the time of a tick with each part."""
    scene = load_scene(SCENE)
    model = display(scene).model
    count_m = model.encoder_quantum_m or 0.0
    trial = simulate(scene, [[*ASKED, 0.0]], SECONDS, keep="ticks")
    positions_m, _ = trial.traces(0)
    tried = {"": (), **{name: (one,) for name, one in parts(count_m, model.rate_hz).items()}}
    rounds = [
        {name: spent_us(scene, given, positions_m) for name, given in tried.items()}
        for _ in range(ROUNDS)
    ]
    least = {name: min(one[name] for one in rounds) for name in tried}
    for name in tried:
        if name:
            yield compared(name, TARGETS[name], least[name], "us", least[""])
    still = np.zeros_like(positions_m)
    own = min(spent_us(scene, tried["law_foaw"], still) for _ in range(ROUNDS))
    alone = min(spent_us(scene, (), still) for _ in range(ROUNDS))
    yield compared("law_foaw_at_rest", TARGETS["law_foaw_at_rest"], own, "us", alone)
