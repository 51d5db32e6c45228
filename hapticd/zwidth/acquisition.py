"""The directed search that the paper left to future work: few trials, each where it gives most
information about the boundary.

A `surrogate` of Re Z(w; K, B, M) predicts the probable boundary. Rays from the middle of the set
meet it in points (`passive_set`). The next trial is the point farthest from all trials so far, so
every trial also confirms the expected boundary. On an affine device 4 trials suffice. With a smooth
non-affine part about 45 leave 2 % of the volume wrong, where a grid of yes and no needs 180,000.

Prior knowledge helps, and each item is optional:

    prior        Re Z as a model predicts it; only the difference from the measurement is learnt
                 (`surrogate`)
    headroom     orders environments by their distance from escape; the headroom that a trial needs
                 is learnt (`least_headroom`)
    independent  how many independent values the estimate has at each frequency. With it the set
                 contains the environments whose trial probably passes; without it, those whose
                 expected Re Z is nowhere negative

Stability is a separate question (K < 0, slow poles, friction overcome): unstable trials give no
spectrum. Without a headroom, environments nearer to an unstable trial than to every stable one are
excluded.

Escape. A loop that only friction keeps stable escapes in a burst of its own motion. Re Z does not
show whether it does so within 90 s, and the transition is abrupt: on one side of the boundary all
trials escape, on the other none. Headroom, a number for every environment that falls towards the
boundary, is known beforehand (`ModelPrior`). The headroom that a trial needs is learnt from trials:

    P(stable) = 1 / (1 + exp(-(headroom - least) / width)),   least ~ N(0, SPREAD^2)

`least` is the mean of its posterior at the likeliest width. A trial on the boundary halves the open
interval, as in a bisection. Where chance decides, many trials settle at the point where half of
them escape.

The model's prior gives Re Z and the headroom against escape of any environment before a trial. Re Z
is that of the recorded channels, with friction linearised at each point, on the frequencies of the
trials.

Friction of b N s/m (linearised) keeps the loop calm; below b_c the sampled loop is unstable by its
spectral radius. Motion s times larger makes friction s times weaker, so the loop escapes in bursts
of b / b_c times the usual motion:

    headroom = 1 / 3 - b_c / b

It is 0 where bursts of three times the usual motion escape, as `linearise` assumes, and positive
where only larger ones do. A loop that is stable without friction has b_c <= 0; b_c is not followed
below -0.4 of the friction at rest. Theory does not give the headroom that a 90 s trial needs; the
trials do. Re Z and b are computed for each point; b_c, smooth in K, B and M, is interpolated on a
grid of the box. If several bodies have friction, it is scaled together.

Limitations: a first trial that is not passive; a set that rays from its middle meet twice; a
headroom that orders environments wrongly, because one number then cannot separate them; a device
that escapes by another mechanism, such as its quantiser.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Flags, Floats
from hapticd.core.errors import AnalysisError
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
from hapticd.zwidth.passive_set import boundary, distance, grid, samples
from hapticd.zwidth.surrogate import (
    Box,
    Observation,
    Prior,
    Surrogate,
    fit,
    log_chance,
    margin,
    margin_sd,
)

__all__ = [
    "ModelPrior",
    "Search",
    "doubtful_share",
    "first_trials",
    "next_trials",
    "predicted_passive",
]

Headroom = Callable[[Floats], Floats]  # environments (N, 3) -> (N,), larger is safer

SPREAD = 0.3  # of the minimum headroom before any trial: uncertainty of the prediction
WIDTHS = (0.01, 0.02, 0.04, 0.08)  # of the step from escape to none, in headroom
_USUAL_WIDTH = 0.02  # median of the width
_WIDTH_SPREAD = 1.0  # standard deviation of its logarithm
_LEAST = np.linspace(-1.0, 1.0, 401)  # headroom that a trial may need
FEWEST = 4  # stable trials before the search can direct
FIRST_STEPS = (0.15, 0.12, 0.10)  # of the box, of K, B and M
_END_INTEREST = 0.3  # of a point at the end of the box, where the set continues
# of a point where escape ends the set: half of such trials give no spectrum
_ESCAPE_INTEREST = 0.5
_NARROW = 0.01  # of headroom, about its minimum


def least_headroom(headroom: Floats, stable: Flags) -> float:
    """Return the minimum headroom of a stable trial, from the headroom (n,) of trials and whether
    each was stable (n,); 0 without trials.
    """
    return max(_posterior(headroom, stable, width) for width in WIDTHS)[1]


def _posterior(headroom: Floats, stable: Flags, width: float) -> tuple[float, float]:
    """Return the logarithm of the evidence for `width`, and the mean of the minimum headroom."""
    beyond = (headroom[:, None] - _LEAST) / width
    seen = -np.logaddexp(0.0, np.where(stable[:, None], -beyond, beyond)).sum(axis=0)
    logs = seen - 0.5 * (_LEAST / SPREAD) ** 2
    share = np.exp(logs - logs.max())
    unusual = 0.5 * (np.log(width / _USUAL_WIDTH) / _WIDTH_SPREAD) ** 2
    return float(logs.max() + np.log(share.sum()) - unusual), float(
        (share * _LEAST).sum() / share.sum()
    )


@dataclass(frozen=True, eq=False)
class Search:
    """State of a search."""

    box: Box  # where to search
    prior: Prior | None = None  # predicted Re Z, if there is a model
    headroom: Headroom | None = None  # against escape, if there is a model
    independent: Floats | None = None  # (F,) independent values of the estimate at each frequency
    trials: tuple[Observation, ...] = ()  # stable ones
    unstable: tuple[Floats, ...] = ()  # environments (3,) of trials that were not stable
    surrogate: Surrogate | None = None  # the fit; None before four stable trials
    least: float = 0.0  # learnt headroom that a stable trial needs

    def with_trials(
        self, environments: npt.ArrayLike, seen: Sequence[Observation | None]
    ) -> "Search":
        """Return the search after trials of `environments` (n, 3); an observation is None where the
        loop was not stable.
        """
        places = np.atleast_2d(np.asarray(environments, np.float64))
        trials = (*self.trials, *(one for one in seen if one is not None))
        unstable = (
            *self.unstable,
            *(place for place, one in zip(places, seen, strict=True) if one is None),
        )
        found = self.surrogate
        if len(trials) > len(self.trials) and len(trials) >= FEWEST:
            found = fit(self.box, trials, self.prior)
        return replace(
            self,
            trials=trials,
            unstable=unstable,
            surrogate=found,
            least=self._least(trials, unstable),
        )

    def _least(self, trials: tuple[Observation, ...], unstable: tuple[Floats, ...]) -> float:
        if self.headroom is None:
            return self.least
        tried = np.array([*(trial.environment for trial in trials), *unstable])
        return least_headroom(self.headroom(tried), np.arange(len(tried)) < len(trials))


def first_trials(box: Box, inside: npt.ArrayLike) -> Floats:
    """Return the first four environments (4, 3): `inside`, which must be passive, and a step from
    it along each axis, towards the farther end. AnalysisError if `inside` lies outside the box.
    """
    centre = box.to_unit(inside)[0]
    if np.any(centre < 0.0) or np.any(centre > 1.0):
        raise AnalysisError(
            f"the first environment {np.asarray(inside).tolist()} lies outside the box"
            f" {box.low}..{box.high}"
        )
    steps = np.diag(np.where(centre <= 0.5, 1.0, -1.0) * np.asarray(FIRST_STEPS))
    return box.to_environment(np.vstack((centre, centre + steps)))


def next_trials(search: Search, count: int = 1) -> Floats:
    """Return the next environments (count, 3) to try, in order: points of the boundary, each the
    farthest from all trials and from those before it.
    """
    found = _fitted(search)
    box = search.box
    unit, ends = boundary(
        lambda at: predicted_passive(search, box.to_environment(at)), _middle(search)
    )
    interest = np.where(ends, _END_INTEREST, 1.0)
    if search.headroom is not None:
        escaping = np.abs(search.headroom(box.to_environment(unit)) - search.least) < _NARROW
        interest[escaping] *= _ESCAPE_INTEREST
    tried = np.vstack((found.unit, box.to_unit(search.unstable))) if search.unstable else found.unit
    chosen: list[Floats] = []
    for _ in range(count):
        gain = distance(unit, np.vstack((tried, *chosen))) * interest
        chosen.append(unit[np.argmax(gain)])
    return box.to_environment(np.stack(chosen))


def predicted_passive(search: Search, environments: npt.ArrayLike) -> Flags:
    """Return whether each of `environments` (N, 3) is predicted passive and stable, (N,)."""
    places = np.atleast_2d(np.asarray(environments, np.float64))
    found = _fitted(search)
    if search.independent is None:
        passive = margin(found, places) >= 0.0
    else:
        passive = log_chance(found, places, search.independent) >= np.log(0.5)
    if search.headroom is not None:
        return passive & (search.headroom(places) >= search.least)
    if search.unstable:
        unit = search.box.to_unit(places)
        passive &= distance(unit, search.box.to_unit(search.unstable)) > distance(unit, found.unit)
    return passive


def doubtful_share(search: Search) -> float:
    """Return the volume whose margin is within one standard deviation of 0, over the volume
    predicted to be passive: a stopping criterion.
    """
    found = _fitted(search)
    inside = search.box.to_environment(samples())
    expected = margin(found, inside)
    passive = int((expected >= 0.0).sum())
    near = np.abs(expected) < np.quantile(np.abs(expected), 0.5)
    doubtful = int((margin_sd(found, inside[near]) > np.abs(expected[near])).sum())
    return doubtful / max(1, passive)


def _fitted(search: Search) -> Surrogate:
    if search.surrogate is None:
        raise AnalysisError(
            f"{len(search.trials)} stable trials so far: four are needed before the search can"
            " direct"
        )
    return search.surrogate


def _middle(search: Search) -> Floats:
    """Return the mean of the set, (3,) in the unit box, or the trial with the largest margin if the
    mean is not inside.
    """
    found = _fitted(search)
    places = samples()
    inside = places[predicted_passive(search, search.box.to_environment(places))]
    mean = inside.mean(axis=0) if len(inside) else found.unit[0]
    if predicted_passive(search, search.box.to_environment(mean))[0]:
        return np.asarray(mean)
    return np.asarray(found.unit[np.argmax(margin(found, search.box.to_environment(found.unit)))])


# --- the prior of a model -------------------------------------------------------------------------


SHAPE = (20, 12, 14)  # of the grid of b_c
SHARES = (  # of the friction at rest, at which stability is computed
    -0.4, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.2, 2.0,
)  # fmt: skip
_LEAST_NS_PER_M = 1e-6


class Known(NamedTuple):
    """The model's prediction for N environments, at F frequencies."""

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
        """Return the headroom (N,) of `environments` (N, 3) against escape, in -1..1."""
        friction = self._known(environments).friction_ns_per_m
        share = self._needed(environments) / np.maximum(friction, _LEAST_NS_PER_M)
        return np.clip(1.0 / BURSTS[-1] - share, -1.0, 1.0)

    def _known(self, environments: Floats) -> Known:
        """Predict, and cache the last result: the search requests Re Z and friction at the same
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
        return [
            linearise(self._loop, part, self._coulomb, self._start, self._perturbation)
            for part in chunks(environments)
        ]


def _needed(
    model: Model, box: Box, rest: Floats, active_damping_ns_per_m: float, filters: Filters
) -> Floats:
    """Return the minimum friction (N,) [N s/m] at which the loop is stable on the table's grid; the
    radius is linear between two values of friction.
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
