"""What a task of a batch carries: a device, an environment and how to simulate them. Values that
pickle, no records.

Everything that a task needs and that is costly to make (reduced model, shape, kernel, torque
record) is made where it runs and kept there (`prepared`, `shared_torque`), so that a task travels
as parameters and seeds only.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import ModuleType
from typing import Any

import numpy as np

from hapticd.analysis.arrays import Values
from hapticd.errors import ConfigError
from hapticd.params import EnvironmentParams
from hapticd.plant.excitation import Stream, held_noise, torque_record
from hapticd.plant.model import Array, Model
from hapticd.plant.scene import DampingStep, Excitation
from hapticd.sim.engine.coordinates import reduced
from hapticd.sim.engine.kernels import kernel
from hapticd.sim.engine.numbers import Filters, plant_numbers
from hapticd.sim.engine.shape import Shape
from hapticd.sim.engine.shaping import shape_of
from hapticd.sim.engine.source import SCALARS
from hapticd.units import PROBE_RATE_HZ

CACHED = 4  # jobs, records: a few are compared, the rest would only fill memory
KEEPS = ("summary", "spectra", "records", "ticks")


@dataclass(frozen=True, eq=False)
class Job:
    """See `batch.simulate` for what each means."""

    model: Model
    environment: EnvironmentParams
    filters: Filters
    damping: tuple[DampingStep, ...]
    excitation: Excitation | Array
    ticks: int
    seed: int
    substeps: int
    dtype: str
    keep: str
    own_torque: bool
    renders: bool  # some trial has an environment
    start_position_m: float
    start_velocity_m_per_s: float

    @property
    def samples(self) -> int:
        """At 4 kHz, of a trial."""
        return round(self.ticks * PROBE_RATE_HZ / self.model.rate_hz)


@dataclass(frozen=True, eq=False)
class Prepared:
    """A job where it runs: `model` in the engine's coordinates, `coordinates` from the model's
    states to those.
    """

    model: Model
    coordinates: Array
    shape: Shape
    kernel: ModuleType
    scalar: type[np.floating[Any]]
    _numbers: dict[float, dict[str, float]] = field(default_factory=dict)

    def numbers(self, level_ns_per_m: float) -> dict[str, float]:
        """Coefficients at that damping level, made once."""
        if level_ns_per_m not in self._numbers:
            self._numbers[level_ns_per_m] = plant_numbers(self.model, self.shape, level_ns_per_m)
        return self._numbers[level_ns_per_m]


@lru_cache(maxsize=CACHED)
def prepared(job: Job) -> Prepared:
    """The kernel and what feeds it, made once per job. ConfigError as `shape_of` and `kernel`."""
    damped = any(step.level_ns_per_m != 0.0 for step in job.damping)
    model, coordinates = reduced(job.model, damped)
    shape = shape_of(model, job.environment, damped, job.substeps, job.dtype)
    if job.keep not in KEEPS:
        raise ConfigError(f"keep {job.keep!r}: use one of {', '.join(KEEPS)}")
    shape = replace(
        shape, renders=job.renders, own_torque=job.own_torque, ticks=job.keep == "ticks"
    )
    return Prepared(model, coordinates, shape, kernel(shape), SCALARS[shape.dtype])


def shared_torque(job: Job) -> Array:
    """The record that all trials get, or one period of it."""
    if isinstance(job.excitation, np.ndarray):
        return _rounded(job.excitation, job.model.torque_quantum_n)
    return drawn(job.excitation, job.samples, job.seed, job.model.torque_quantum_n)


@lru_cache(maxsize=CACHED)
def drawn(excitation: Excitation, samples: int, seed: int, quantum_n: float | None) -> Array:
    """The same for all jobs that ask for it."""
    return _rounded(torque_record(excitation, samples, seed, Stream.SHARED), quantum_n)


def played(record: Array, samples: int, scalar: type[np.floating[Any]]) -> Values:
    """A shared record, or its period, as the kernel plays it from the first sample to the last."""
    return np.resize(record.astype(scalar), samples)


def own_torque(job: Job, trial: int) -> Array:
    """The record of one trial."""
    if isinstance(job.excitation, np.ndarray):
        return _rounded(job.excitation[trial], job.model.torque_quantum_n)
    return _rounded(
        torque_record(job.excitation, job.samples, job.seed, Stream.TORQUE + trial),
        job.model.torque_quantum_n,
    )


def estimate_noise(job: Job) -> Array:
    """Noise of the velocity estimate, shared by all trials; one zero if there is none."""
    noise = job.model.noise
    if noise is None or not noise.estimate_psd:
        return np.zeros(1)
    return held_noise(job.samples, noise.estimate_psd, job.seed, Stream.ESTIMATE)


def _rounded(force_n: Array, quantum_n: float | None) -> Array:
    return force_n if quantum_n is None else np.floor(force_n / quantum_n + 0.5) * quantum_n
