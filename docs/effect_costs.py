"""Time cost of each effect of a simulated device: `python docs/effect_costs.py` measures it on this
machine, and writes docs/figures/effect-costs.json for the page of effects.

The scene of the paper's Fig. 7 is the yardstick. One effect at a time is left out, or added if the
scene lacks it. The change is a share of the yardstick, timed in turns with it.

A crowbar shorts the motor, so it replaces amplifier and damping circuit.

Limitations: a machine with other load; shares then scatter by several percent, and small ones have
no meaning.
"""

import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

from hapticd.core.errors import HapticdError
from hapticd.core.units import NS_PER_S
from hapticd.model.effects import ALWAYS, KINDS
from hapticd.run.lockstep import LockStep, scene_params
from hapticd.settings.scene import load_files, load_scene
from hapticd.studies.effects import GROUP
from hapticd.zwidth.engine.batch import simulate

COSTS = Path(__file__).parent / "figures" / "effect-costs.json"
YARDSTICK = "fig7"
REPLACED = {"crowbar": {"amplifier", "damping_circuit"}}  # by an incompatible effect
# numbers of an effect that the device does not have
MORE = """[model.velocity_highpass]
corner_hz = 0.1
source = "inferred"
"""
PAIRS = 61
ENGINE_S = 4.0  # simulated
TICKS = 200  # of the stack
SCENE = """title = "costs"
device = "weir2008"
effects = {effects}
[environment]
stiffness_n_per_m = 50.0
virtual_damping_ns_per_m = 2.0
[[active_damping]]
level_ns_per_m = 1.74
[excitation]
kind = "noise"
"""


def scene_file(folder: Path, name: str, effects: list[str]) -> Path:
    """Write the yardstick's scene with other effects."""
    path = folder / f"{name}.toml"
    path.write_text(SCENE.format(effects=json.dumps(effects)) + MORE)
    return path


class Timed:
    """A scene ready to be timed, in the engine and as the whole stack."""

    def __init__(self, path: Path) -> None:
        self.scene = load_scene(path)
        self.group = [self.scene.environment.free] * GROUP
        self.stack = LockStep(*scene_params(path), keep=False)
        self.ways: dict[str, Callable[[], object]] = {
            "engine_s": lambda: simulate(self.scene, self.group, ENGINE_S),
            "lockstep_s": lambda: self.stack.run(TICKS),
        }
        for run in self.ways.values():  # compiled, and at rest
            run()

    def seconds(self, way: str) -> float:
        """Return the processor time of one run."""
        begin = time.process_time_ns()
        self.ways[way]()
        return (time.process_time_ns() - begin) / NS_PER_S


def share(yardstick: Timed, folder: Path, key: str, before: list[str]) -> dict[str, Any]:
    """Return the cost of the effect `key` in the engine and in the whole stack, as a share of the
    yardstick. It is the median of many pairs, timed in direct succession.
    """
    there = key in before
    replaced = [name for name in before if name not in REPLACED.get(key, {key})]
    changed = Timed(scene_file(folder, key, replaced if there else [*replaced, key]))
    found: dict[str, Any] = {"key": key, "in_yardstick": there}
    for way in changed.ways:
        ratios = [changed.seconds(way) / yardstick.seconds(way) for _ in range(PAIRS)]
        found[way] = (-1.0 if there else 1.0) * (median(ratios) - 1.0)
    changed.stack.close()
    return found


def main() -> None:
    """Measure every effect and write the shares."""
    before = list(load_files(YARDSTICK).scene.effects)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        yardstick = Timed(scene_file(folder, "yardstick", before))
        for kind in KINDS:
            if kind.key in ALWAYS:
                continue
            try:
                rows.append(share(yardstick, folder, kind.key, before))
            except HapticdError as error:
                rows.append({"key": kind.key, "why_not": str(error).rpartition(": ")[2]})
        own = {way: min(yardstick.seconds(way) for _ in range(PAIRS)) for way in yardstick.ways}
        yardstick.stack.close()
    costs = {
        "engine_s": own["engine_s"] / (ENGINE_S * GROUP),
        "lockstep_s": own["lockstep_s"] / (1e-3 * TICKS),
        "effects": rows,
    }
    COSTS.write_text(json.dumps(costs, indent=1) + "\n")


if __name__ == "__main__":
    main()
