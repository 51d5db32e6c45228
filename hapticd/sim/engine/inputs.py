"""What drives a group, leg by leg: torque and noise, and where legs end.

A leg is a run of ticks with one damping level, inside one period of the torque record, no longer
than a block (and, where a winding heats up, than its refresh; where spectra are kept, inside one
section).
"""

from collections.abc import Iterator
from functools import lru_cache
from itertools import pairwise
from math import lcm

import numpy as np

from hapticd.analysis.arrays import Values
from hapticd.analysis.spa import DEFAULT_LAG as LAG
from hapticd.sim.engine.heating import REFRESH_S
from hapticd.sim.engine.job import Job, Prepared, estimate_noise, own_torque, shared_torque

BLOCK_TICKS = 8192


class Inputs:
    """Torque and noise in the kernel's layout. A record that is shorter than the trial repeats."""

    def __init__(self, job: Job, made: Prepared, count: int, first: int) -> None:
        self._samples = made.shape.samples
        self._lanes = made.shape.lanes if job.own_torque else 1
        self._torque = _own(job, made, count, first) if job.own_torque else _shared(job, made)
        self._noise = estimate_noise(job).astype(made.scalar)
        self._borders = _borders(job, made, len(self._torque) // self._samples)

    def legs(self) -> Iterator[tuple[int, int]]:
        """(first tick, tick after the last) of every leg."""
        return pairwise(self._borders)

    def torque(self, start: int, end: int) -> Values:
        """For the ticks of a leg, flat."""
        begin = start * self._samples % len(self._torque)
        return self._torque[begin : begin + (end - start) * self._samples].reshape(-1)

    def noise(self, start: int, end: int) -> Values:
        """For the ticks of a leg; one zero if there is none."""
        return (
            self._noise
            if len(self._noise) == 1
            else self._noise[start * self._samples : end * self._samples]
        )

    def rows(self, count: int, total: int) -> Values:
        """The records of the trials, (count, total)."""
        return np.resize(self._torque, (total, self._lanes)).T[:count].copy()


def level_at(job: Job, tick: int) -> float:
    """Damping level [Ns/m] that acts from `tick` on, as its DAC gives it."""
    asked = [
        step.level_ns_per_m for step in job.damping if round(step.at_s * job.model.rate_hz) <= tick
    ]
    level = asked[-1]
    quantum = job.model.damping_quantum_ns_per_m
    return level if quantum is None else float(np.floor(level / quantum + 0.5) * quantum)


@lru_cache(maxsize=2)
def _shared(job: Job, made: Prepared) -> Values:
    """(period, 1)"""
    return _repeated(shared_torque(job).astype(made.scalar)[:, None], job, made)


def _own(job: Job, made: Prepared, count: int, first: int) -> Values:
    """(period, lanes)"""
    rows = [own_torque(job, first + lane).astype(made.scalar) for lane in range(count)]
    record = np.zeros((len(rows[0]), made.shape.lanes), made.scalar)
    for lane, row in enumerate(rows):
        record[:, lane] = row
    return _repeated(record, job, made)


def _repeated(record: Values, job: Job, made: Prepared) -> Values:
    period = _period(len(record), made.shape.samples, job.samples)
    return record if len(record) == period else np.resize(record, (period, record.shape[1]))


def _period(length: int, samples: int, total: int) -> int:
    """Samples after which the record repeats: whole ticks, and at least a block unless the
    trial is shorter.
    """
    whole = lcm(length, samples)
    return min(total, whole * -(-BLOCK_TICKS * samples // whole))


def _borders(job: Job, made: Prepared, period: int) -> list[int]:
    steps = [BLOCK_TICKS, period]
    if job.keep == "spectra" and not LAG % made.shape.samples:
        steps.append(LAG // made.shape.samples)
    if made.model.winding is not None:
        steps.append(max(1, round(REFRESH_S * job.model.rate_hz)))
    ticks = {tick for step in steps for tick in range(0, job.ticks, step)}
    ticks |= {round(step.at_s * job.model.rate_hz) for step in job.damping}
    return sorted({tick for tick in ticks if 0 <= tick < job.ticks} | {job.ticks})
