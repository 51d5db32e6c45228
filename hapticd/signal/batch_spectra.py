"""Spectra of many trials that share one force record, computed during simulation without storing
velocity records.

The method is that of `covariances`, for all trials in parallel. Every 2,048 samples, `batch_fft`
transforms each trial's section once and sums six numbers per frequency. The force is the same for
all trials, so its transforms are computed once. With U of the velocity, Y of the force, s = (-1)^k
for a delay of one section:

    velocity   sum conj(U_i) (U_i + s U_i+1)
    forward    sum conj(U_i) (Y_i + s Y_i+1)
    backward   sum U_i conj(Y_i + s Y_i-1)

Trends are removed from the sums afterwards (`line_products`). float32 adds an error of 1e-7 of the
largest value of a spectrum.

Trials must share one force record, and the window must have 2,048 samples (use `spa` for others).
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from hapticd.core.arrays import (
    CACHE_LINE,
    Complexes,
    Floats,
    Integers,
    Values,
    aligned,
    alternating,
)
from hapticd.signal.covariances import NO_SAMPLES, Moments, Sections, line_products
from hapticd.signal.spectra import DEFAULT_LAG as LAG
from hapticd.signal.spectra import on_the_grid

__all__ = ["BatchSections", "SharedForce", "shared_force"]

TOGETHER = 8  # pending sections, 4 MB: a vector's sums are loaded into the cache once for all


@dataclass(frozen=True, eq=False)
class SharedForce:
    """A force record (N,), prepared once for all trials."""

    table: Values  # (sections, pairs of bins, 8): transforms with the section after and before, N
    covariance: Floats  # (M + 1,) biased, of the record with its trend, N^2
    moments: Moments  # of the record, to remove its trend

    @property
    def spectrum(self) -> Floats:
        """Spectrum of the detrended record on the window's frequencies (M + 1,) [N^2]."""
        own = self.covariance - line_products(self.moments, self.moments, LAG)
        return np.maximum(on_the_grid(own, own).real, 0.0)


def shared_force(force_n: Floats, scalar: type[np.floating[Any]]) -> SharedForce:
    """Prepare `force_n` (N,) float64 for sums in `scalar`, float32 or float64."""
    count = -(-force_n.size // LAG)
    padded = np.zeros((count + 2, 2 * LAG))  # a section of zeros before and after
    np.copyto(padded[1:-1, :LAG], _cut(force_n, count))
    found = np.fft.rfft(padded, axis=1)
    sign = alternating(LAG + 1)
    ahead = found[1:-1] + sign * found[2:]
    behind = found[1:-1] + sign * found[:-2]
    lower = _bins()
    upper = LAG - _bins()
    columns = [
        part
        for k in (lower, upper)
        for z in (ahead[:, k], behind[:, k])
        for part in (z.real, z.imag)
    ]
    sums = Sections(LAG)
    sums.add(force_n, force_n)
    return SharedForce(
        np.stack(columns, axis=-1).astype(scalar),
        sums.covariances().force,
        NO_SAMPLES.extended(force_n, LAG),
    )


class BatchSections:
    """Spectral sums over `count` trials, a multiple of a vector's lanes (16 float32, 8 float64)."""

    def __init__(self, force: SharedForce, count: int, scalar: type[np.floating[Any]]) -> None:
        from hapticd.signal import batch_fft as compiled

        self._force = force
        self._scalar = scalar
        self._compiled: Any = compiled
        self._lanes = CACHE_LINE // np.dtype(scalar).itemsize
        self._vectors = count // self._lanes
        self._taken = 0
        self._sums = self._room(self._vectors * compiled.PAIRS * compiled.KEPT).reshape(
            self._vectors, -1
        )
        self._waiting = self._room(self._vectors * TOGETHER * LAG).reshape(
            self._vectors, TOGETHER, -1
        )
        self._held = 0  # sections that wait
        self._newest_moments = self._room(3 * self._vectors).reshape(self._vectors, -1)
        self._rooms = (
            self._room(compiled.AT_ONCE * compiled.WORK).reshape(compiled.AT_ONCE, -1),
            self._room(compiled.PART),
        )
        self._tables = [
            np.ascontiguousarray(table, scalar) for table in (*compiled.twiddles(), _turn())
        ]
        self._order = compiled.pair_order()[0]
        self._moments = np.zeros((len(force.table), 3, count))
        self._ends: list[Floats] = []  # first section, and the last two, (count, M)

    def add(self, samples: Values, place: Integers) -> None:
        """Add the next section of all trials. `samples` is flat and aligned to 64 bytes; sample t
        of the section is the `count` values from vector place[t] on. Samples after the end of the
        record are 0.
        """
        if self._taken == len(self._force.table):
            raise ValueError(f"section {self._taken + 1}: the record has {self._taken}")
        self._compiled.gather(samples, place, self._waiting, self._held, self._newest_moments)
        by_vector = self._newest_moments.reshape(self._vectors, 3, self._lanes)
        self._moments[self._taken] = by_vector.swapaxes(0, 1).reshape(3, -1)
        if self._taken == 0 or self._taken >= len(self._force.table) - 2:
            self._ends.append(self._copied())
        self._taken += 1
        self._held += 1
        if self._held == TOGETHER:
            self._sum()

    def _sum(self) -> None:
        """Transform the pending sections and add them to the sums."""
        force = self._force.table[self._taken - self._held : self._taken]
        self._compiled.add_sections(
            self._waiting, self._held, self._sums, force, *self._rooms, *self._tables, self._order
        )
        self._held = 0

    @property
    def squares(self) -> Floats:
        """Sum of the squared velocity in each section (sections, count) [(m/s)^2]."""
        return self._moments[:, 2]

    def spectra(self) -> tuple[Floats, Complexes]:
        """Return velocity and cross spectra as `spa` does, (count, M + 1) each, in (m/s)^2 and N
        m/s. All sections must have been added.
        """
        if self._held:
            self._sum()
        count = self._vectors * self._lanes
        u = self._velocity()
        velocity = np.empty((count, LAG + 1))
        cross = np.empty((count, LAG + 1), np.complex128)
        for first in range(0, count, self._lanes):  # as many as fit into the cache
            some = slice(first, first + self._lanes)
            mine = Moments(u.length, u.total[some], u.moment[some], u.head[some], u.tail[some])
            velocity[some], cross[some] = self._finished(first // self._lanes, mine)
        return velocity, cross

    def _finished(self, vector: int, u: Moments) -> tuple[Floats, Complexes]:
        y = self._force.moments
        lags = [np.fft.irfft(z, axis=-1)[:, : LAG + 1] / u.length for z in self._summed(vector)]
        velocity = lags[0] - line_products(u, u, LAG)
        forward = lags[1] - line_products(y, u, LAG)
        backward = lags[2] - line_products(u, y, LAG)
        return np.maximum(on_the_grid(velocity, velocity).real, 0.0), on_the_grid(forward, backward)

    def _summed(self, vector: int) -> Complexes:
        """Return the three sums of the module docstring, (3, lanes, M + 1)."""
        pair, side = _place_of_bin()
        rows = self._sums[vector].reshape(self._compiled.PAIRS, self._compiled.KEPT, self._lanes)
        sums = rows[:, :12].reshape(-1, 2, 3, 2, self._lanes)[pair, side]
        real, imaginary = rows[:, 12:].reshape(-1, 2, 2, self._lanes)[pair, side].swapaxes(0, 1)
        found = np.empty((3, self._lanes, LAG + 1), np.complex128)
        found.real = sums[:, :, 0].transpose(1, 2, 0)
        found.imag = sums[:, :, 1].transpose(1, 2, 0)
        # the compiled loops return twice each spectrum
        found *= np.array((0.25, 0.5, 0.5))[:, None, None]
        # nothing follows the last section
        found[0] += 0.25 * (real * real + imaginary * imaginary).T
        found[2].imag *= -1.0
        return found

    def _velocity(self) -> Moments:
        n = self._force.moments.length
        first = LAG * np.arange(len(self._moments), dtype=np.float64)
        total = self._moments[:, 0]
        moment = self._moments[:, 1]
        last = np.concatenate(self._ends[-2:], axis=1) if len(self._ends) > 1 else self._ends[0]
        # samples of the two last sections before the end of the record; beyond it there are zeros
        rest = n - LAG * (len(self._moments) - 1) + last.shape[1] - LAG
        return Moments(
            n,
            total.sum(axis=0),
            (moment + first[:, None] * total).sum(axis=0),
            self._ends[0],
            last[:, max(0, rest - LAG) : rest],
        )

    def _copied(self) -> Floats:
        """Return the newest pending section, (count, M)."""
        section = self._waiting[:, self._held].reshape(self._vectors, LAG, self._lanes)
        return section.swapaxes(1, 2).reshape(-1, LAG).astype(np.float64)

    def _room(self, vectors: int) -> Values:
        return aligned(vectors * self._lanes, self._scalar)


def _cut(signal: Floats, count: int) -> Floats:
    padded = np.zeros(count * LAG)
    padded[: signal.size] = signal
    return padded.reshape(count, LAG)


@cache
def _bins() -> Integers:
    from hapticd.signal.batch_fft import pair_order

    return np.asarray(pair_order()[1])


@cache
def _place_of_bin() -> tuple[Integers, Integers]:
    """Pair of every bin 0..M, and whether the bin is the upper one of its pair."""
    pair = np.empty(LAG + 1, np.int64)
    side = np.zeros(LAG + 1, np.int64)
    pair[_bins()] = np.arange(_bins().size)
    pair[LAG - _bins()] = np.arange(_bins().size)
    side[LAG - _bins()] = 1
    return pair, side


def _turn() -> Floats:
    """Return exp(-2 pi i k / 4096) of the lower bin of each pair, (pairs, 2)."""
    turn = np.exp(-1j * np.pi * _bins() / LAG)
    return np.stack((turn.real, turn.imag), axis=-1)
