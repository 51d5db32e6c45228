"""Learning Re Z(w; K, B, M) from few trials: a Gaussian process on top of prior knowledge.

For a rigid collocated device Re Z is affine in (K, B, M) at each w, so the passive set is convex
and four trials determine it. Real devices deviate. The deviation is a Gaussian process of the
environment (radial basis functions, one length for all frequencies), so at each frequency

    Re Z = c0 + c (K, B, M) + g + e,   g ~ GP(amplitude^2 exp(-d^2 / 2 length^2))

with g of the same statistics at all frequencies and e the trial's own noise as weight. c, g and
their uncertainty have closed forms (generalised least squares, universal kriging: Matheron 1969).
The process learns the spectrum instead of the yes or no, or its minimum (which noise biases). This
needs 40 times fewer trials than a surrogate of the margin.

Length and amplitude maximise the restricted likelihood on a coarse grid, which is as fine as a few
dozen trials can resolve. The coefficients c are integrated out (Patterson and Thompson 1971), so
four trials that a plane fits exactly do not give false certainty. Without noise the amplitude has a
closed form at each length. With noise the likelihood of 12 frequencies decides, each with the noise
of its own trials.

If a model of the device exists, its prediction is the mean: a prior gives Re Z of any environment,
and only measured - predicted is learnt, one constant c0 per frequency and g.

A trial passes if its estimate of Re Z is not negative at any frequency. With noise this requires
more than the expected Re Z >= 0. The probability of a pass is the product of Phi(Re Z / sd) over
the number of independent frequencies (`log_chance`).

Environments are scaled to a unit box. Limitations: trials that were not stable (their spectra are
of a limit cycle; leave them out); a device or a prior whose Re Z jumps, because the learnt function
must be smooth. With fewer than `FEW` trials the likelihood is not informative, and a fixed length
is used.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Floats
from hapticd.core.errors import AnalysisError

__all__ = ["Box", "Observation", "margin"]

Prior = Callable[[Floats], Floats]  # environments (N, 3) -> Re Z (N, F)

LENGTHS = (0.15, 0.2, 0.3, 0.45, 0.7, 1.2)  # of the unit box
# shares of the residual scatter attributed to the process
SHARES = (0.03, 0.1, 0.2, 0.35, 0.6, 1.0)
SOME = 12  # frequencies whose likelihood decides where trials are noisy
FEW = 8  # trials below which the likelihood is not informative
FIRST_LENGTH = 0.45
_NUGGET = 1e-6  # of amplitude^2: keeps the matrices regular
_LEAST_AMPLITUDE = 1e-12  # N s/m
_LEAST_SD = 1e-12  # N s/m
_ROUNDS = 4  # of the amplitude at one length; one suffices without noise
_TOGETHER = 4096  # environments at once
_LOGISTIC = 1.702  # Phi(x) = 1 / (1 + exp(-1.702 x)) to 0.01 (Haley 1952)


def kernel(one: Floats, other: Floats, length: float) -> Floats:
    """Return exp(-d^2 / 2 length^2) (N, n) between `one` (N, 3) and `other` (n, 3)."""
    square = ((one[:, None] - other) ** 2).sum(axis=2)
    return np.asarray(np.exp(-0.5 * square / length**2))


def precision(
    unit: Floats, trend: Floats, noise: Floats, length: float, amplitude: float
) -> tuple[Floats, Floats]:
    """Return the inverse (G, n, n) of the covariance of n trials at `unit` (n, 3) with `noise` (G,
    n), and the covariance (G, t, t) of the slopes of `trend` (n, t). G = 1 if all frequencies are
    alike, otherwise F.
    """
    process = amplitude**2 * (kernel(unit, unit, length) + _NUGGET * np.eye(len(unit)))
    inverse = np.asarray(np.linalg.inv(process + noise[:, :, None] * np.eye(len(unit))), np.float64)
    return inverse, np.asarray(np.linalg.inv(trend.T @ inverse @ trend), np.float64)


def likeliest(unit: Floats, trend: Floats, values: Floats, noise: Floats) -> tuple[float, float]:
    """Return length and amplitude of maximum likelihood; `values` (F, n), `noise` (G, n)."""
    rest = values.T - trend @ np.linalg.lstsq(trend, values.T, rcond=None)[0]
    scale = (
        float(np.sqrt(np.mean(rest**2) * len(unit) / max(1, len(unit) - trend.shape[1])))
        + _LEAST_AMPLITUDE
    )
    if len(unit) < FEW:
        return FIRST_LENGTH, scale
    if len(noise) == 1:
        return min(_matched(unit, trend, values, noise, length, scale) for length in LENGTHS)[1:]
    some = np.linspace(0, len(values) - 1, min(SOME, len(values))).round().astype(int)
    tried = [(length, share * scale) for length in LENGTHS for share in SHARES]
    return min(
        tried, key=lambda process: _misfit(unit, trend, values[some], noise[some], *process)[0]
    )


def _matched(
    unit: Floats, trend: Floats, values: Floats, noise: Floats, length: float, amplitude: float
) -> tuple[float, float, float]:
    """Return misfit, length and the amplitude at which the whitened residual has variance 1: exact
    without noise.
    """
    for _ in range(_ROUNDS):
        misfit, variance = _misfit(unit, trend, values, noise, length, amplitude)
        amplitude = max(amplitude * float(np.sqrt(variance)), _LEAST_AMPLITUDE)
    return misfit, length, amplitude


def _misfit(
    unit: Floats, trend: Floats, values: Floats, noise: Floats, length: float, amplitude: float
) -> tuple[float, float]:
    """Negative restricted log-likelihood per frequency, and variance of the whitened residual."""
    inverse, spread = precision(unit, trend, noise, length, amplitude)
    y = values[:, :, None]
    # the residual after the trend that fits it best under this covariance
    white = inverse @ (y - trend @ (spread @ (trend.T @ (inverse @ y))))
    square = max(0.0, float((y * white).sum()) / len(values))
    logs = np.linalg.slogdet(inverse)[1].mean() + np.linalg.slogdet(spread)[1].mean()
    return 0.5 * (square - float(logs)), square / (len(unit) - trend.shape[1])


@dataclass(frozen=True, slots=True)
class Box:
    """The range of the search."""

    low: tuple[float, float, float]  # minimum K N/m, B N s/m, M kg
    high: tuple[float, float, float]  # maximum K N/m, B N s/m, M kg

    def to_unit(self, environments: npt.ArrayLike) -> Floats:
        """Map environments (N, 3) to the unit box."""
        low = np.asarray(self.low)
        return np.asarray((np.atleast_2d(environments) - low) / (np.asarray(self.high) - low))

    def to_environment(self, unit: npt.ArrayLike) -> Floats:
        """Map points (N, 3) of the unit box to environments."""
        low = np.asarray(self.low)
        return np.asarray(low + np.atleast_2d(unit) * (np.asarray(self.high) - low))


@dataclass(frozen=True, eq=False)
class Observation:
    """The result of one stable trial."""

    environment: Floats  # (3,) K N/m, B N s/m, M kg
    resistance: Floats  # (F,) Re Z, N s/m
    sd: Floats  # (F,) its standard deviation, N s/m; 0 if exact


@dataclass(frozen=True, eq=False)
class Surrogate:
    """The fitted process over n trials and F frequencies; G = 1 if all frequencies are alike,
    otherwise F.
    """

    box: Box
    unit: Floats  # (n, 3) trials in the unit box
    slopes: Floats  # (F, t) of 1, K, B and M, or of 1 alone with a prior, N s/m
    weights: Floats  # (F, n) of the trials in the residual of the slopes
    inverse: Floats  # (G, n, n) of the covariance, (N s/m)^-2
    spread: Floats  # (G, t, t) covariance of the slopes
    length: float  # of the process, in the unit box
    amplitude: float  # of the process, N s/m
    sd: Floats  # (F,) median over the trials' own, N s/m
    prior: Prior | None = None  # predicted Re Z, the mean of the process


def fit(box: Box, trials: Sequence[Observation], prior: Prior | None = None) -> Surrogate:
    """Fit the surrogate to `trials`, at least four that span the box. AnalysisError for fewer, or
    for spectra on different frequencies.
    """
    if len(trials) < 4 or len({trial.resistance.size for trial in trials}) != 1:
        raise AnalysisError(
            f"{len(trials)} trials: at least four with spectra on the same frequencies are needed"
            " to begin"
        )
    places = np.stack([trial.environment for trial in trials])
    unit = box.to_unit(places)
    values = np.stack([trial.resistance for trial in trials]).T
    sd = np.stack([trial.sd for trial in trials]).T
    if np.linalg.matrix_rank(np.column_stack((np.ones(len(unit)), unit))) < 4:
        raise AnalysisError("the first trials lie in a plane: vary K, B and M each at least once")
    if prior is not None:
        values = values - prior(places).T
    trend = _trend(unit, prior)
    noise = sd**2 if sd.any() else np.zeros((1, len(unit)))
    length, amplitude = likeliest(unit, trend, values, noise)
    inverse, spread = precision(unit, trend, noise, length, amplitude)
    by_frequency = values[:, :, None]
    slopes = spread @ (trend.T @ (inverse @ by_frequency))
    weights = inverse @ (by_frequency - trend @ slopes)
    return Surrogate(
        box,
        unit,
        slopes[:, :, 0],
        weights[:, :, 0],
        inverse,
        spread,
        length,
        amplitude,
        np.median(sd, axis=1),
        prior,
    )


def resistance(found: Surrogate, environments: npt.ArrayLike) -> Floats:
    """Return the expected Re Z (N, F) [N s/m]."""
    places = np.atleast_2d(np.asarray(environments, np.float64))
    unit = found.box.to_unit(places)
    near = found.amplitude**2 * kernel(unit, found.unit, found.length)
    learnt = _trend(unit, found.prior) @ found.slopes.T + near @ found.weights.T
    return learnt if found.prior is None else learnt + found.prior(places)


def margin(found: Surrogate, environments: npt.ArrayLike) -> Floats:
    """Return the minimum over the frequencies of the expected Re Z (N,) [N s/m]."""
    return np.concatenate([resistance(found, part).min(axis=1) for part in _parts(environments)])


def log_chance(found: Surrogate, environments: npt.ArrayLike, independent: Floats) -> Floats:
    """Return the logarithm (N,) of the probability that a trial's estimate has Re Z >= 0
    throughout, with `independent` (F,) values at each frequency.
    """
    if not found.sd.any():
        return np.where(margin(found, environments) >= 0.0, 0.0, -np.inf)
    # the logistic replaces Phi: its logarithm is accurate in the tails as well
    scale = -_LOGISTIC / np.maximum(found.sd, _LEAST_SD)
    return np.concatenate(
        [
            -np.logaddexp(0.0, resistance(found, part) * scale) @ independent
            for part in _parts(environments)
        ]
    )


def margin_sd(found: Surrogate, environments: npt.ArrayLike) -> Floats:
    """Return the standard deviation (N,) of Re Z at the frequency of its minimum [N s/m]."""
    places = np.atleast_2d(np.asarray(environments, np.float64))
    unit = found.box.to_unit(places)
    worst = (
        np.argmin(resistance(found, places), axis=1)
        if len(found.inverse) > 1
        else np.zeros(len(unit), np.int64)
    )
    near = found.amplitude**2 * kernel(unit, found.unit, found.length)
    gained = np.einsum("ni,nij->nj", near, found.inverse[worst])
    missed = _trend(unit, found.prior) - gained @ _trend(found.unit, found.prior)
    variance = (
        found.amplitude**2
        - (gained * near).sum(axis=1)
        + np.einsum("ni,nij,nj->n", missed, found.spread[worst], missed)
    )
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _parts(environments: npt.ArrayLike) -> list[Floats]:
    places = np.atleast_2d(np.asarray(environments, np.float64))
    return [places[first : first + _TOGETHER] for first in range(0, len(places), _TOGETHER)]


def _trend(unit: Floats, prior: Prior | None) -> Floats:
    """Return the columns (N, 4) of 1, K, B, M, or (N, 1) of 1 if a prior gives the slopes."""
    one = np.ones((len(unit), 1))
    return one if prior is not None else np.column_stack((one, unit))
