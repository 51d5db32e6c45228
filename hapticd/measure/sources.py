"""Where a trial's record comes from: the batch engine, a file, or a daemon (`bench`). All give a `Recorded`.

A record that is there already is shown to the sentinel second by second, as a daemon would show it, and cut where it would
have ended the trial.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import inf, nan

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.measure.progress import Progress, silent
from hapticd.measure.scenes import free_of_walls
from hapticd.measure.store import Recorded
from hapticd.measure.watch import Sentinel, Watch
from hapticd.plant.compose import compose
from hapticd.plant.scene import Excitation, Scene
from hapticd.sim.engine import simulate

LEAST_KEPT_S = 8.0
NOISE = Excitation("noise")


@dataclass(frozen=True, slots=True)
class Trial:
    """What a source is asked for: K [N/m], B [Ns/m], M [kg], electrical damping [Ns/m], length, perturbation with its seed."""

    environment: tuple[float, float, float] = (0.0, 0.0, 0.0)
    damping_ns_per_m: float = 0.0
    seconds: float = 90.0
    excitation: Excitation = NOISE
    watch: Watch = field(default_factory=Watch)
    waveform_n: Floats | None = field(default=None, compare=False)  # at 4 kHz, repeated; in place of the excitation


Source = Callable[[Trial, Progress], Recorded]


def engine_source(scene: Scene, substeps: int = 4) -> Source:
    """Trials of `scene`'s device by the batch engine."""

    def record(trial: Trial, tell: Progress = silent) -> Recorded:
        tell("simulating", 0, 1)
        found = simulate(
            scene, [trial.environment], trial.seconds, trial.excitation.seed, damping=trial.damping_ns_per_m,
            environment=free_of_walls(scene), start=(0.0, 0.0), substeps=substeps, keep="ticks",
            excitation=trial.excitation if trial.waveform_n is None else trial.waveform_n,
        )  # fmt: skip
        tell("simulated", 1, 1)
        limit_n, (force, velocity) = compose(scene).force_limit_n, found.record(0)
        whole = Recorded(
            np.asarray(force, np.float64), np.asarray(velocity, np.float64), found.rate_hz, f"engine, scene {scene.name}", True,
            f"escape: diverged after {found.diverged_at_s[0]:.3g} s" if found.diverged[0] else "",
            float(found.max_force_n[0]), limit_n,
        )  # fmt: skip
        watch = replace(trial.watch, command_limit_n=inf if limit_n is None else limit_n)
        winding_c = nan if found.winding_c is None else float(found.winding_c[0])
        commands = np.abs(np.asarray(found.force_n)[0])
        flown = round(commands.size * whole.seconds / found.seconds)
        return _watched(whole, watch, winding_c, commands[:flown])

    return record


def file_source(recorded: Recorded) -> Source:
    """The record of a file, whatever is asked; environment and damping are then what the user says they were."""
    return lambda trial, tell: _watched(recorded, trial.watch)


def _watched(whole: Recorded, watch: Watch, winding_c: float = nan, command_n: Floats | None = None) -> Recorded:
    """`whole` up to where the sentinel would have ended it. `command_n` (ticks,): sizes of the commands beside it."""
    sentinel, second, total = Sentinel(watch, whole.rate_hz), round(whole.rate_hz), whole.force_n.size
    for start in range(0, total, second):
        part = slice(start, start + second)
        ticks = (
            np.zeros(1) if command_n is None else command_n[start * len(command_n) // total : part.stop * len(command_n) // total]
        )
        if sentinel.see(whole.force_n[part], whole.velocity_m_per_s[part], winding_c, float(ticks.max(initial=0.0))):
            break
    if not sentinel.reason:
        return whole
    kept = max(round(LEAST_KEPT_S * whole.rate_hz), round(sentinel.seconds * whole.rate_hz))  # what is there may as well be judged
    return replace(whole, force_n=whole.force_n[:kept], velocity_m_per_s=whole.velocity_m_per_s[:kept], ended=sentinel.reason)
