"""The stored output of a group: its blocks become rows of records, or spectra at once.

keep = "spectra": a section of 2,048 samples of all lanes is 0.6 MB. Spectra are computed while it
is still in the cache (`signal.batch_spectra`), so only six sums per frequency of a trial are
stored. That needs one torque record for all trials and a velocity that is recorded without change.
If trials have their own torque, or the probe adds noise or counts, the group's records are kept
until its end and analysed one by one. The spectra are the same, but take longer.

A block must not end inside a section (legs end at sections, see `job`).
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import CACHE_LINE, Floats, Values, aligned
from hapticd.model.excitation import Stream, generator
from hapticd.model.scene import Excitation
from hapticd.signal.batch_spectra import BatchSections, SharedForce, shared_force
from hapticd.signal.spectra import DEFAULT_LAG as LAG
from hapticd.signal.spectra import spa
from hapticd.zwidth.engine.job import (
    BLOCK_TICKS,
    CACHED,
    Inputs,
    Job,
    Prepared,
    drawn,
    played,
    rounded,
    shared_torque,
)
from hapticd.zwidth.engine.source import SCALARS

Samples = npt.NDArray[np.int64]


class Records:
    """The kept arrays of some trials of a batch; the numbers seed their noise."""

    def __init__(self, job: Job, made: Prepared, numbers: Sequence[int]) -> None:
        shape = made.shape
        self._job = job
        self._made = made
        self._numbers = numbers
        self.kept = job.keep != "summary"
        self._out = aligned(
            min(job.ticks, BLOCK_TICKS) * shape.width * shape.lanes if self.kept else 1, made.scalar
        )
        self._places = {"velocity_m_per_s": (0, shape.samples)} if self.kept else {}
        if self.kept and shape.impulse is not None:
            self._places["torque_n"] = (shape.samples + 1, shape.samples)
        if shape.ticks:
            self._places |= {"force_n": (shape.samples, 1), "position_m": (shape.width - 1, 1)}
        self._arrays: dict[str, Values] = {
            name: np.zeros((len(numbers), job.ticks * wide), made.scalar)
            for name, (_, wide) in self._places.items()
        }

    def block(self, start: int) -> Values:
        """Return the buffer for the leg from tick `start` on."""
        return self._out

    def store(self, start: int, end: int, alive: Values) -> None:
        """Store the output of the leg from tick `start` to `end`."""
        if not self.kept:
            return
        shape = self._made.shape
        ticks = end - start
        block = self._out[: ticks * shape.width * shape.lanes].reshape(
            ticks, shape.width, shape.lanes
        )
        for name, (place, wide) in self._places.items():
            array = self._arrays[name]
            part = block[:, place : place + wide, : len(array)]
            array[:, start * wide : end * wide] = part.transpose(2, 0, 1).reshape(len(array), -1)

    def finished(self, samples: Samples, inputs: Inputs) -> dict[str, Any]:
        """Return the records by their names in BatchResult, cut at the ends of their trials, after
        `samples` (count,).
        """
        arrays = self._arrays
        if not self.kept:
            return arrays
        arrays["velocity_m_per_s"] = self._measured(arrays["velocity_m_per_s"])
        if self._job.own_torque and "torque_n" not in arrays:
            arrays["torque_n"] = inputs.rows(len(samples), arrays["velocity_m_per_s"].shape[1])
        for array in arrays.values():
            per_sample = array.shape[1] / self._job.samples
            for row, end in zip(array, samples, strict=True):
                row[int(end * per_sample) :] = 0.0
        return arrays

    def _measured(self, velocity: Values) -> Values:
        """Return the velocity behind the probe's amplifier and converter."""
        noise = self._job.model.noise
        quantum = self._job.model.velocity_quantum_m_per_s
        if noise is not None and noise.velocity_m_per_s:
            for number, row in zip(self._numbers, velocity, strict=True):
                row += noise.velocity_m_per_s * generator(
                    self._job.seed, Stream.VELOCITY + number
                ).standard_normal(len(row))
        return rounded(velocity, quantum)


def spectral(job: Job, made: Prepared, numbers: Sequence[int]) -> "Sums | SpectraOfRecords":
    """Return the store for the spectra of a group."""
    noise = job.model.noise
    shape = made.shape
    measured = (
        noise is not None and noise.velocity_m_per_s
    ) or job.model.velocity_quantum_m_per_s is not None
    if job.own_torque or measured or shape.impulse is not None or LAG % shape.samples:
        return SpectraOfRecords(job, made, numbers)
    return Sums(job, made, len(numbers))


class Sums:
    """Sums of spectra, as the module describes; used as `Records`."""

    kept = True

    def __init__(self, job: Job, made: Prepared, count: int) -> None:
        shape = made.shape
        self._count = count
        self._samples = job.samples
        self._lanes = shape.lanes
        self._tick = shape.width * shape.lanes
        self._section = LAG // shape.samples  # ticks
        self._filled = 0  # ticks
        # of one section: it stays in the second-level cache until it is transformed
        self._out = aligned(self._section * self._tick, made.scalar)
        sample = np.arange(LAG)
        row = sample // shape.samples * shape.width + sample % shape.samples
        self._place = row * (shape.lanes * made.scalar().itemsize // CACHE_LINE)
        self._sections = BatchSections(_force(job, made), shape.lanes, made.scalar)

    def block(self, start: int) -> Values:
        """Return the buffer for a leg from tick `start` on."""
        return self._out[start % self._section * self._tick :]

    def store(self, start: int, end: int, alive: Values) -> None:
        """Store the leg, without the lanes that diverged: only whole sections count."""
        self._filled = (end - 1) % self._section + 1
        if not alive.all():
            rows = self._out[: self._filled * self._tick].reshape(-1, self._lanes)
            rows[:, alive == 0.0] = 0.0
        if self._filled == self._section:
            self._add()

    def _add(self) -> None:
        """Add the pending section to the sums; the last one may be short."""
        self._out[self._filled * self._tick :] = 0.0
        self._sections.add(self._out, self._place)
        self._filled = 0

    def finished(self, samples: Samples, inputs: Inputs) -> dict[str, Any]:
        """Return the spectra by their names in BatchResult."""
        if self._filled:
            self._add()
        velocity: Values = np.zeros((self._lanes, LAG + 1))
        cross = velocity + 0j
        if (samples == self._samples).any():
            velocity, cross = self._sections.spectra()
        squares = self._sections.squares[:, : self._count]
        return {
            "velocity_spectrum": velocity[: self._count],
            "cross_spectrum": cross[: self._count],
            "section_rms_m_per_s": np.sqrt(squares.T / _lengths(self._samples)),
        }


class SpectraOfRecords(Records):
    """The same from records; used as `Records`."""

    def finished(self, samples: Samples, inputs: Inputs) -> dict[str, Any]:
        """Return the spectra by their names in BatchResult."""
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
    """Return the spectrum of the record that all trials share (M + 1,)."""
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
    """Return the force, cached for all jobs that request it: the costly part of a small task."""
    return _prepared_for(drawn(excitation, samples, seed, quantum_n), samples, SCALARS[dtype])


def _prepared_for(record: Floats, samples: int, scalar: type[np.floating[Any]]) -> SharedForce:
    return shared_force(np.asarray(played(record, samples, scalar), np.float64), scalar)


def _lengths(samples: int) -> Samples:
    """Return the number of samples in each section."""
    return np.minimum(LAG, samples - np.arange(0, samples, LAG))
