"""keep = "spectra": a group's spectra instead of its records, summed section by section while it is simulated.

A section of 2,048 samples of all lanes is 0.5 MB: it is transformed while it is still in the cache (`analysis.lanes`), so
nothing of a trial is stored but six sums a frequency. That needs one torque record for all trials and a velocity that is
recorded as it is; where trials have their own torque, or the probe adds noise or counts, the group's records are kept
until its end and analysed one by one, which gives the same spectra more slowly.
"""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticd.analysis.arrays import CACHE_LINE, Complexes, Floats, Values, aligned
from hapticd.analysis.lanes import LaneSections, SharedForce, shared_force
from hapticd.analysis.spa import DEFAULT_LAG as LAG
from hapticd.analysis.spa import spa
from hapticd.sim.engine.inputs import Inputs
from hapticd.sim.engine.job import CACHED, Job, Prepared, shared_torque
from hapticd.sim.engine.records import Records

Samples = npt.NDArray[np.int64]


def spectral(job: Job, made: Prepared, count: int, first: int) -> "Sums | SpectraOfRecords":
    """What keeps the spectra of a group."""
    noise, shape = job.model.noise, made.shape
    measured = (noise is not None and noise.velocity_m_per_s) or job.model.velocity_quantum_m_per_s is not None
    if job.own_torque or measured or shape.impulse is not None or LAG % shape.samples:
        return SpectraOfRecords(job, made, count, first)
    return Sums(job, made, count)


class Sums:
    """See the module; used as `Records`."""

    kept = True

    def __init__(self, job: Job, made: Prepared, count: int) -> None:
        shape, self._count, self._samples = made.shape, count, job.samples
        self._lanes, self._tick = shape.lanes, shape.width * shape.lanes
        self._ticks, self._end = LAG // shape.samples, job.ticks
        self._out = aligned(self._ticks * self._tick, made.scalar)
        sample = np.arange(LAG)
        row = sample // shape.samples * shape.width + sample % shape.samples
        self._place = row * (shape.lanes * made.scalar().itemsize // CACHE_LINE)
        self._sections = LaneSections(_force(job, made), shape.lanes, made.scalar)

    def room(self, start: int) -> Values:
        """Where the kernel writes a leg from tick `start` on."""
        return self._out[start % self._ticks * self._tick :]

    def store(self, start: int, end: int, alive: Values) -> None:
        """Take the leg; a section that is complete goes into the sums, without the lanes that diverged."""
        rows = self._out.reshape(-1, self._lanes)
        if not alive.all():
            rows[:, alive == 0.0] = 0.0
        if end % self._ticks and end != self._end:
            return
        if end % self._ticks:
            self._out[end % self._ticks * self._tick :] = 0.0
        self._sections.add(self._out, self._place)

    def finished(self, samples: Samples, inputs: Inputs) -> dict[str, Any]:
        """By their names in BatchResult."""
        velocity, cross = self._sections.spectra() if (samples == self._samples).any() else _nothing(self._lanes)
        squares = np.zeros((len(self._sections.squares), self._count))
        squares[:] = self._sections.squares[:, : self._count]
        return {
            "velocity_spectrum": velocity[: self._count],
            "cross_spectrum": cross[: self._count],
            "section_rms_m_per_s": np.sqrt(squares.T / _lengths(self._samples)),
        }


class SpectraOfRecords(Records):
    """The same from records; used as `Records`."""

    def finished(self, samples: Samples, inputs: Inputs) -> dict[str, Any]:
        """By their names in BatchResult."""
        kept = super().finished(samples, inputs)
        velocity = np.asarray(kept["velocity_m_per_s"], np.float64)
        shared = None if "torque_n" in kept else shared_record(self._job, self._made)
        force = np.asarray(kept["torque_n"], np.float64) if shared is None else np.broadcast_to(shared, velocity.shape)
        found = [spa(*channels) for channels in zip(force, velocity, strict=True)]
        starts = np.arange(0, velocity.shape[1], LAG)
        own = {} if shared is not None else {"force_spectrum": np.stack([trial.force for trial in found])}
        return {
            "velocity_spectrum": np.stack([trial.velocity for trial in found]),
            "cross_spectrum": np.stack([trial.cross for trial in found]),
            "section_rms_m_per_s": np.sqrt(np.add.reduceat(velocity**2, starts, axis=1) / _lengths(velocity.shape[1])),
            **own,
        }


def force_spectrum(job: Job, made: Prepared) -> Floats:
    """Of the record that all trials share (M + 1,)."""
    return _force(job, made).spectrum


def shared_record(job: Job, made: Prepared) -> Floats:
    """That record as the trials get it (samples,)."""
    return np.resize(shared_torque(job).astype(made.scalar), job.samples).astype(np.float64)


def _force(job: Job, made: Prepared) -> SharedForce:
    """Made once for all jobs with one excitation: it is the costly part of a small task."""
    if isinstance(job.excitation, np.ndarray):
        return shared_force(shared_record(job, made), made.scalar)
    return _prepared(_Same((job.excitation, job.samples, job.seed, job.model.torque_quantum_n, made.scalar), job, made))


@dataclass(frozen=True)
class _Same:
    """A job by what its torque record depends on."""

    key: tuple[object, ...]
    job: Job = field(compare=False)
    made: Prepared = field(compare=False)


@lru_cache(maxsize=CACHED)
def _prepared(same: _Same) -> SharedForce:
    return shared_force(shared_record(same.job, same.made), same.made.scalar)


def _lengths(samples: int) -> Samples:
    """Samples in each section."""
    return np.minimum(LAG, samples - np.arange(0, samples, LAG))


def _nothing(lanes: int) -> tuple[Values, Complexes]:
    return np.zeros((lanes, LAG + 1)), np.zeros((lanes, LAG + 1), np.complex128)
