"""Simulated trials of a scene by the batch engine.

Walls and soft ends of a scene are omitted, because the impedance of an environment is measured away
from them.
"""

from dataclasses import replace
from math import inf, nan

import numpy as np

from hapticd.model.compose import compose
from hapticd.model.scene import Scene
from hapticd.zwidth import sources
from hapticd.zwidth.engine.batch import BatchResult, simulate
from hapticd.zwidth.store import EndReason, Progress, TrialEnd, TrialRecord, silent

__all__ = ["engine_source", "simulated"]


def engine_source(scene: Scene, substeps: int = 4) -> sources.Source:
    """Return a source of trials of `scene`'s device by the batch engine."""

    def record(trial: sources.Trial, tell: Progress = silent) -> TrialRecord:
        tell("simulating", 0, 1)
        found = simulate(
            scene,
            [trial.environment],
            trial.seconds,
            trial.excitation.seed,
            active_damping=trial.active_damping_ns_per_m,
            environment=scene.free_of_walls,
            start=(0.0, 0.0),
            substeps=substeps,
            keep="ticks",
            excitation=trial.excitation if trial.waveform_n is None else trial.waveform_n,
        )
        tell("simulated", 1, 1)
        whole = simulated(scene, found)
        watch = replace(
            trial.watch,
            command_limit_n=inf if whole.command_limit_n is None else whole.command_limit_n,
        )
        winding_c = nan if found.winding_c is None else float(found.winding_c[0])
        _, commands = found.traces(0)
        return sources.watched(whole, watch, winding_c, np.abs(commands))

    return record


def simulated(scene: Scene, found: BatchResult) -> TrialRecord:
    """Return the first trial of a batch that kept its records."""
    force, velocity = (np.asarray(channel, np.float64) for channel in found.record(0))
    escape = TrialEnd(EndReason.ESCAPE, f"diverged after {found.diverged_at_s[0]:.3g} s")
    ticks = round(found.samples[0] * scene.rate_hz / found.rate_hz)
    counts = {} if found.limited is None else {
        "limited_ticks": round(found.limited[0] * ticks), "ticks": ticks,
    }  # fmt: skip
    return TrialRecord(
        force, velocity, found.rate_hz, f"engine, scene {scene.name}", True,
        escape if found.diverged[0] else None,
        float(found.max_force_n[0]), compose(scene).force_limit_n, more=counts,
    )  # fmt: skip
