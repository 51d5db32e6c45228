"""What a simulated second of a scene costs, measured: in the batch engine, and in lock-step with the whole product.

The engine computes a group of trials with every instruction, so its cost is that of a full group, for each trial.
"""

from dataclasses import dataclass
from pathlib import Path

from hapticd.assembly.lockstep import LockStep
from hapticd.assembly.scene import scene_params
from hapticd.measure.scenes import point
from hapticd.measure.stopwatch import Stopwatch, quickest
from hapticd.plant.scene import Scene
from hapticd.sim.engine import simulate
from hapticd.sim.engine.shape import LANES

ENGINE_S = 4.0
REPEATS = 9  # the quickest counts: other programs only make it slower
LOCKSTEP_S = 0.5
SETTLING_TICKS = 100  # of a lock-step stack, before it is timed


@dataclass(frozen=True, slots=True)
class Cost:
    """Seconds of one core per simulated second: `engine_s` of one trial in a full group of `lanes`, `lockstep_s` of the stack."""

    engine_s: float
    lanes: int
    lockstep_s: float


def engine_cost(scene: Scene, now_ns: Stopwatch, seconds: float = ENGINE_S, substeps: int = 1, dtype: str = "f64") -> float:
    """Seconds per simulated second of one trial in a full group. The kernel is compiled before. ConfigError as `simulate`."""
    group = [point(scene)] * LANES[dtype]
    simulate(scene, group, 1.0 / scene.rate_hz, substeps=substeps, dtype=dtype)
    _, spent = quickest(now_ns, lambda: simulate(scene, group, seconds, substeps=substeps, dtype=dtype), REPEATS)
    return spent / (seconds * len(group))


def lockstep_cost(source: str | Path, now_ns: Stopwatch, seconds: float = LOCKSTEP_S) -> float:
    """Seconds per simulated second of the whole stack with the scene's device on the simulated board, nothing enabled."""
    servo, board = scene_params(source)
    ticks = round(seconds * servo.realtime.rate_hz)
    with LockStep(servo, board, keep=False) as stack:
        stack.run(SETTLING_TICKS)
        return quickest(now_ns, lambda: stack.run(ticks))[1] / seconds


def cost(scene: Scene, source: str | Path, now_ns: Stopwatch) -> Cost:
    """Both; `source` is the scene's name or file."""
    return Cost(engine_cost(scene, now_ns), LANES["f64"], lockstep_cost(source, now_ns))
