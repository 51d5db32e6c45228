"""`simulate`: a batch of trials of one scene, on threads of this process or on any executor."""

from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticd.analysis.spa import DEFAULT_LAG as LAG
from hapticd.errors import ConfigError
from hapticd.params import EnvironmentParams
from hapticd.plant.compose import compose
from hapticd.plant.model import Array, Model
from hapticd.plant.scene import DampingStep, Excitation, Scene
from hapticd.sim.engine.chunk import run_chunk
from hapticd.sim.engine.cores import workers
from hapticd.sim.engine.job import Job, played, prepared, shared_torque
from hapticd.sim.engine.numbers import Filters
from hapticd.sim.engine.result import BatchResult, joined
from hapticd.sim.engine.spectral import force_spectrum
from hapticd.units import PROBE_RATE_HZ

DEFAULT_SECONDS = 90.0  # a trial of the paper
TICKS_MAX = 1e12
SEEDS = 1 << 63
REMOTE_GROUPS = (
    4  # groups of lanes in a task of a foreign executor, whose tasks cost more to hand over
)


def simulate(
    scene: Scene | Model,
    params: npt.ArrayLike,
    seconds: float | None = None,
    seed: int | None = None,
    *,
    damping: float | Sequence[tuple[float, float]] | None = None,
    environment: EnvironmentParams | None = None,
    filters: Filters | None = None,
    excitation: Excitation | npt.ArrayLike | None = None,
    start: tuple[float, float] | None = None,
    substeps: int = 1,
    dtype: str = "f64",
    keep: str = "summary",
    own_torque: bool = False,
    executor: Executor | None = None,
    chunk: int | None = None,
) -> BatchResult:
    """Simulate n trials of `scene`, a scene or a composed model, that differ in what is rendered.

    params       (n, 3) stiffness [N/m], damping [Ns/m], mass [kg]
    seconds      length of a trial
    seed         of everything random
    damping      electrical damping level [Ns/m], or steps (time s, level)
    environment  filters, wall and soft ends of the law; its K, B, M are not used
    filters      of velocity and acceleration in place of those; None for raw differences
    excitation   of the probe, or forces [N] at 4 kHz that repeat: (samples,), with own_torque (n,
                 samples)
    start        position [m] and velocity [m/s] of all bodies
    substeps     per 4 kHz sample; only friction, ends and cogging need them, without those there is
                 one
    dtype        "f64" | "f32"
    keep         "summary" | "spectra" as `analysis.spa` | "records" at 4 kHz |
                 "ticks": also position and force of every tick
    own_torque   a record of its own for every trial instead of a shared one
    executor     any of concurrent.futures; None = threads here
    chunk        trials per task

    What is None is the scene's; for a model: 90 s, seed 1, no damping, the paper's filters, noise
    of 2.5e-5 N^2/Hz up to 1.7 kHz, at rest at 0. The same call gives the same bytes for any
    executor and chunk. ConfigError for arguments out of range, a rate that does not divide 4 kHz,
    or without numba.
    """
    trials = _checked(params)
    job = _job(
        scene,
        seconds,
        seed,
        damping,
        environment,
        filters,
        excitation,
        start,
        substeps=substeps,
        dtype=dtype,
        keep=keep,
        own_torque=own_torque,
        renders=bool(trials.any())
        or keep == "ticks"
        or _solid(environment or getattr(scene, "environment", None)),
    )
    if chunk is not None and chunk < 1:
        raise ConfigError(f"{chunk} trials in a task: must be 1 or more, or None")
    made = prepared(job)  # compiles once, before there are threads that would wait for it
    size = chunk or made.shape.lanes * (1 if executor is None else REMOTE_GROUPS)
    firsts = range(0, len(trials), size)
    parts = [trials[first : first + size] for first in firsts]
    if executor is not None:
        found = list(executor.map(partial(run_chunk, job), parts, firsts))
    else:
        with ThreadPoolExecutor(max_workers=min(len(parts), workers())) as threads:
            found = list(threads.map(partial(run_chunk, job), parts, firsts))
    result = joined(found)
    if keep == "spectra" and result.force_spectrum is None:
        return replace(result, force_spectrum=force_spectrum(job, made))
    if keep in ("summary", "spectra") or result.torque_n is not None:
        return result
    return replace(result, torque_n=played(shared_torque(job), job.samples, made.scalar))


def _job(
    scene: Scene | Model,
    seconds: float | None,
    seed: int | None,
    damping: float | Sequence[tuple[float, float]] | None,
    environment: EnvironmentParams | None,
    filters: Filters | None,
    excitation: Excitation | npt.ArrayLike | None,
    start: tuple[float, float] | None,
    **rest: Any,
) -> Job:
    given = scene if isinstance(scene, Scene) else None
    model = compose(scene) if isinstance(scene, Scene) else scene
    length_s = seconds if seconds is not None else given.seconds if given else DEFAULT_SECONDS
    if not 0.5 <= length_s * model.rate_hz <= TICKS_MAX:
        raise ConfigError(
            f"a trial of {length_s:g} s: must be one tick of {1.0 / model.rate_hz:g} s or more,"
            f" {TICKS_MAX:g} at most"
        )
    if rest["keep"] == "spectra" and length_s * PROBE_RATE_HZ < LAG + 1:
        raise ConfigError(
            f"spectra of {length_s:g} s: more than the window of {LAG} samples,"
            f" {LAG / PROBE_RATE_HZ:g} s, are needed"
        )
    number = seed if seed is not None else given.excitation.seed if given else 1
    if not 0 <= number < SEEDS:
        raise ConfigError(f"seed {number}: must lie in 0..{SEEDS - 1}")
    source = (
        excitation if excitation is not None else given.excitation if given else Excitation("noise")
    )
    position_m, velocity_m_per_s = start or (
        (given.start_position_m, given.start_velocity_m_per_s) if given else (0.0, 0.0)
    )
    rendered = environment or (given.environment if given else EnvironmentParams())
    return Job(
        model=model,
        environment=rendered,
        filters=filters or (rendered.velocity_filter, rendered.acceleration_filter),
        damping=_steps(damping) if damping is not None else given.damping if given else _steps(0.0),
        excitation=(
            source if isinstance(source, Excitation) else np.asarray(source, dtype=np.float64)
        ),
        ticks=round(length_s * model.rate_hz),
        seed=number,
        start_position_m=position_m,
        start_velocity_m_per_s=velocity_m_per_s,
        **rest,
    )


def _solid(environment: EnvironmentParams | None) -> bool:
    """Whether there is something to touch beside K, B and M."""
    return environment is not None and bool(
        environment.wall.side or environment.workspace.stiffness_n_per_m
    )


def _steps(damping: float | Sequence[tuple[float, float]]) -> tuple[DampingStep, ...]:
    steps = [(0.0, damping)] if isinstance(damping, int | float) else [(0.0, 0.0), *damping]
    if not np.isfinite(steps).all():
        raise ConfigError(f"damping steps {steps}: finite times [s] and levels [N s/m] are needed")
    return tuple(
        DampingStep(at_s, level) for at_s, level in sorted(steps, key=lambda step: step[0])
    )


def _checked(params: npt.ArrayLike) -> Array:
    trials = np.ascontiguousarray(params, dtype=np.float64)
    if trials.ndim != 2 or trials.shape[1] != 3 or not len(trials):
        raise ConfigError(
            f"params of shape {trials.shape}: must be (n, 3), stiffness N/m, damping Ns/m and mass"
            " kg of n >= 1 trials"
        )
    if not np.isfinite(trials).all():
        raise ConfigError("params contain a value that is not finite")
    return trials
