"""What a model says of any environment before a trial, for the directed search: Re Z, and headroom
against escape.

Re Z is that of the recorded channels, with friction linearised at each point, on the frequencies
that trials are kept at.

Headroom: friction of b N s/m (linearised) keeps the loop calm; below b_c the sampled loop is
unstable by its spectral radius. Motion s times larger makes friction s times weaker, so the loop
escapes in bursts of b / b_c times the usual motion:

    headroom = 1 / 3 - b_c / b

0 where bursts of three times the usual escape, as `linearise` assumes; above, larger ones are
needed; a loop that is stable without friction has b_c <= 0, and is not followed below -0.4 of the
friction at rest. Which headroom 90 s of trial need is not known from theory (`search` learns it).

Re Z and b are computed for each point; b_c, smooth in K, B and M, is interpolated on a grid of the
box. Where several bodies rub, their friction is scaled together. What would break it: a device that
escapes otherwise, as by its quantiser.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from hapticd.core.arrays import Floats
from hapticd.model.linearise import BURSTS, Linearised, Perturbation, linearise, recorded_impedance
from hapticd.model.loop import Filters, close_loop, spectral_radius
from hapticd.model.model import Model
from hapticd.model.predict import (
    NOMINAL_NS_PER_M,
    chunks,
    coulomb,
    frequencies,
    with_equivalent_damping,
)
from hapticd.signal.passive_set import grid
from hapticd.signal.surrogate import Box

__all__ = ["ModelPrior"]

SHAPE = (20, 12, 14)  # of the grid of b_c
SHARES = (  # of the friction at rest, at which stability is looked at
    -0.4, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.2, 2.0,
)  # fmt: skip
_LEAST_NS_PER_M = 1e-6


class Known(NamedTuple):
    """What the model says of N environments, at F frequencies."""

    environments: Floats  # (N, 3)
    resistance_ns_per_m: Floats  # (N, F), Re Z
    friction_ns_per_m: Floats  # (N,), linearised, of all bodies together


class ModelPrior:
    """`resistance` and `headroom` of `model` at a level of active damping, for environments in
    `box`.
    """

    def __init__(
        self,
        model: Model,
        box: Box,
        frequency_hz: Floats,
        active_damping_ns_per_m: float,
        filters: Filters,
        perturbation: Perturbation,
    ) -> None:
        self._coulomb = coulomb(model)
        self._perturbation = perturbation
        f = np.union1d(frequencies((frequency_hz[0], frequency_hz[-1]), perturbation), frequency_hz)
        self._at = np.searchsorted(f, frequency_hz)
        self._start = np.where(self._coulomb > 0.0, NOMINAL_NS_PER_M, 0.0)
        self._loop = close_loop(
            with_equivalent_damping(model, self._start), f, active_damping_ns_per_m, filters
        )
        rest = self._linearised(np.zeros((1, 3)))[0].friction[:, 0]
        self._needed = _Table(box, _needed(model, box, rest, active_damping_ns_per_m, filters))
        self._last: Known | None = None

    def resistance(self, environments: Floats) -> Floats:
        """Predicted Re Z (N, F) [N s/m] of `environments` (N, 3)."""
        return self._known(environments).resistance_ns_per_m

    def headroom(self, environments: Floats) -> Floats:
        """Headroom (N,) of `environments` (N, 3) against escape, in -1..1."""
        friction = self._known(environments).friction_ns_per_m
        share = self._needed(environments) / np.maximum(friction, _LEAST_NS_PER_M)
        return np.clip(1.0 / BURSTS[-1] - share, -1.0, 1.0)

    def _known(self, environments: Floats) -> Known:
        """The last answer is kept, because the search asks for Re Z and friction at the same
        points in turn.
        """
        if self._last is None or not np.array_equal(self._last.environments, environments):
            parts = self._linearised(environments)
            true = np.concatenate([part.impedance for part in parts])
            z = recorded_impedance(self._loop, environments, true)[:, self._at].real
            friction = np.concatenate([part.friction.sum(axis=0) for part in parts])
            self._last = Known(environments.copy(), z, friction)
        return self._last

    def _linearised(self, environments: Floats) -> list[Linearised]:
        parts = chunks(environments)
        return [
            linearise(self._loop, part, self._coulomb, self._start, self._perturbation)
            for part in parts
        ]


def _needed(
    model: Model, box: Box, rest: Floats, active_damping_ns_per_m: float, filters: Filters
) -> Floats:
    """Least friction (N,) [N s/m] at which the loop is stable on the table's grid; between two
    values of friction the radius is taken for a straight line.
    """
    places = grid(_axes(box))
    usual = float(rest.sum()) or 1.0
    growth = [
        spectral_radius(
            with_equivalent_damping(model, share * rest), places, active_damping_ns_per_m, filters
        )
        - 1.0
        for share in SHARES
    ]
    needed = np.full(len(places), SHARES[0])
    for share, after, this, following in zip(SHARES, SHARES[1:], growth, growth[1:], strict=False):
        with np.errstate(divide="ignore", invalid="ignore"):
            between = share + (after - share) * this / (this - following)
        needed = np.where(this >= 0.0, np.where(following < 0.0, between, after), needed)
    return needed * usual


def _axes(box: Box) -> tuple[Floats, Floats, Floats]:
    k, b, m = (
        np.linspace(box.low[place], box.high[place], count) for place, count in enumerate(SHAPE)
    )
    return k, b, m


class _Table:
    """Values on a grid of a box, linear in between, constant beyond."""

    def __init__(self, box: Box, values: Floats) -> None:
        self._box = box
        self._values = values.reshape(SHAPE)

    def __call__(self, environments: Floats) -> Floats:
        last = np.array(SHAPE) - 1
        at = np.clip(self._box.to_unit(environments), 0.0, 1.0) * last
        cell = np.minimum(at.astype(int), last - 1)
        return sum(
            (self._corner(cell, at - cell, corner) for corner in product((0, 1), repeat=3)),
            np.zeros(len(at)),
        )

    def _corner(self, cell: Floats, share: Floats, corner: Sequence[int]) -> Floats:
        weight = np.where(np.array(corner) == 1, share, 1.0 - share).prod(axis=1)
        k, b, m = (cell + np.array(corner)).T
        return np.asarray(weight * self._values[k, b, m])
