"""keep = "spectra": a group's spectra instead of its records, summed section by section while it is
simulated.

A section of 2,048 samples of all lanes is 0.5 MB: it is transformed while it is still in the cache
(`analysis.lanes`), so nothing of a trial is stored but six sums a frequency. That needs one torque
record for all trials and a velocity that is recorded as it is; where trials have their own torque,
or the probe adds noise or counts, the group's records are kept until its end and analysed one by
one, which gives the same spectra more slowly.
"""

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticd.analysis.arrays import CACHE_LINE, Complexes, Floats, Values, aligned
from hapticd.analysis.lanes import LaneSections, SharedForce, shared_force
from hapticd.analysis.spa import DEFAULT_LAG as LAG
from hapticd.analysis.spa import spa
from hapticd.plant.scene import Excitation
from hapticd.sim.engine.inputs import Inputs
from hapticd.sim.engine.job import CACHED, Job, Prepared, drawn, played, shared_torque
from hapticd.sim.engine.records import Records
from hapticd.sim.engine.source import SCALARS

Samples = npt.NDArray[np.int64]


def spectral(job: Job, made: Prepared, count: int, first: int) -> "Sums | SpectraOfRecords":
    """What keeps the spectra of a group."""
    noise = job.model.noise
    shape = made.shape
    measured = (
        noise is not None and noise.velocity_m_per_s
    ) or job.model.velocity_quantum_m_per_s is not None
    if job.own_torque or measured or shape.impulse is not None or LAG % shape.samples:
        return SpectraOfRecords(job, made, count, first)
    return Sums(job, made, count)


class Sums:
    """See the module; used as `Records`."""

    kept = True

    def __init__(self, job: Job, made: Prepared, count: int) -> None:
        shape = made.shape
        self._count = count
        self._samples = job.samples
        self._lanes = shape.lanes
        self._tick = shape.width * shape.lanes
        self._ticks = LAG // shape.samples
        self._end = job.ticks
        self._out = aligned(self._ticks * self._tick, made.scalar)
        sample = np.arange(LAG)
        row = sample // shape.samples * shape.width + sample % shape.samples
        self._place = row * (shape.lanes * made.scalar().itemsize // CACHE_LINE)
        self._sections = LaneSections(_force(job, made), shape.lanes, made.scalar)

    def room(self, start: int) -> Values:
        """Where the kernel writes a leg from tick `start` on."""
        return self._out[start % self._ticks * self._tick :]

    def store(self, start: int, end: int, alive: Values) -> None:
        """Take the leg; a section that is complete goes into the sums, without the lanes that
        diverged.
        """
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
        velocity, cross = (
            self._sections.spectra() if (samples == self._samples).any() else _nothing(self._lanes)
        )
        squares = self._sections.squares[:, : self._count]
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
        own = "torque_n" in kept
        torque = (
            kept["torque_n"]
            if own
            else played(shared_torque(self._job), velocity.shape[1], self._made.scalar)
        )
        force = np.broadcast_to(np.asarray(torque, np.float64), velocity.shape)
        found = [spa(*channels) for channels in zip(force, velocity, strict=True)]
        starts = np.arange(0, velocity.shape[1], LAG)
        return {
            "velocity_spectrum": np.stack([trial.velocity for trial in found]),
            "cross_spectrum": np.stack([trial.cross for trial in found]),
            "section_rms_m_per_s": np.sqrt(
                np.add.reduceat(velocity**2, starts, axis=1) / _lengths(velocity.shape[1])
            ),
            **({"force_spectrum": np.stack([trial.force for trial in found])} if own else {}),
        }


def force_spectrum(job: Job, made: Prepared) -> Floats:
    """Of the record that all trials share (M + 1,)."""
    return _force(job, made).spectrum


def _force(job: Job, made: Prepared) -> SharedForce:
    if isinstance(job.excitation, np.ndarray):
        return _prepared_for(shared_torque(job), job.samples, made.scalar)
    return _drawn(
        job.excitation, job.samples, job.seed, job.model.torque_quantum_n, made.shape.dtype
    )


@lru_cache(maxsize=CACHED)
def _drawn(
    excitation: Excitation, samples: int, seed: int, quantum_n: float | None, dtype: str
) -> SharedForce:
    """Made once for all jobs that ask for it: it is the costly part of a small task."""
    return _prepared_for(drawn(excitation, samples, seed, quantum_n), samples, SCALARS[dtype])


def _prepared_for(record: Floats, samples: int, scalar: type[np.floating[Any]]) -> SharedForce:
    return shared_force(np.asarray(played(record, samples, scalar), np.float64), scalar)


def _lengths(samples: int) -> Samples:
    """Samples in each section."""
    return np.minimum(LAG, samples - np.arange(0, samples, LAG))


def _nothing(lanes: int) -> tuple[Values, Complexes]:
    return np.zeros((lanes, LAG + 1)), np.zeros((lanes, LAG + 1), np.complex128)
