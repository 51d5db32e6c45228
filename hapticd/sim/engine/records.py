"""What is kept of a group: its blocks of output become rows of records."""

from typing import Any

import numpy as np

from hapticd.analysis.arrays import Values, aligned
from hapticd.plant.excitation import Stream, generator
from hapticd.sim.engine.inputs import BLOCK_TICKS, Inputs
from hapticd.sim.engine.job import Job, Prepared


class Records:
    """The kept arrays of the trials `first`... of a batch."""

    def __init__(self, job: Job, made: Prepared, count: int, first: int) -> None:
        shape = made.shape
        self._job = job
        self._made = made
        self._first = first
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
            name: np.zeros((count, job.ticks * wide), made.scalar)
            for name, (_, wide) in self._places.items()
        }

    def room(self, start: int) -> Values:
        """Where the kernel writes the leg from tick `start` on."""
        return self._out

    def store(self, start: int, end: int, alive: Values) -> None:
        """Take what the leg from tick `start` to `end` left there."""
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

    def finished(
        self, samples: "np.ndarray[tuple[int], np.dtype[np.int64]]", inputs: Inputs
    ) -> dict[str, Any]:
        """The records by their names in BatchResult, ended where their trials ended: after
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
        """As the probe's amplifier and converter show it."""
        noise = self._job.model.noise
        quantum = self._job.model.velocity_quantum_m_per_s
        if noise is not None and noise.velocity_m_per_s:
            for trial, row in enumerate(velocity, self._first):
                row += noise.velocity_m_per_s * generator(
                    self._job.seed, Stream.VELOCITY + trial
                ).standard_normal(len(row))
        return velocity if quantum is None else np.floor(velocity / quantum + 0.5) * quantum
