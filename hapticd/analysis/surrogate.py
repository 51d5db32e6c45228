"""Learning Re Z(w; K, B, M) from few trials: affine in the environment at every frequency, plus what is left over.

For a rigid collocated device Re Z is affine in (K, B, M) at each w, so the passive set is convex and four trials know it.
Real devices bend this: the rest is a Gaussian process of the environment (radial basis functions, one length for all
frequencies), so at each frequency  Re Z = c0 + c (K, B, M) + g + e,  g ~ GP(amplitude^2 exp(-d^2 / 2 length^2)), e the trial's
own noise as weight. c, g and their uncertainty follow in closed form (generalised least squares, universal kriging: Matheron
1969); length and amplitude are those of greatest likelihood on a coarse grid. Learning the spectrum and not the yes or no, nor
its minimum (which noise biases), is what saves trials: 40 times fewer than a surrogate of the margin.

Environments are scaled to a unit box. What would break it: trials that were not stable (their spectra are of a limit cycle;
do not feed them), or a device whose Re Z jumps.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hapticd.analysis.arrays import Floats
from hapticd.errors import AnalysisError

LENGTHS = (0.15, 0.2, 0.3, 0.45, 0.7, 1.2)  # of the unit box
FEW = 8  # trials below which likelihood has nothing to say
FIRST_LENGTH = 0.45
_NUGGET = 1e-6  # of amplitude^2: keeps the matrices regular
_LEAST = 1e-12  # N s/m of amplitude
_ROUNDS = 4
_TOGETHER = 4096


@dataclass(frozen=True, slots=True)
class Box:
    """Where to look: lowest and highest (K, B, M) [N/m, N s/m, kg]."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def to_unit(self, environments: npt.ArrayLike) -> Floats:
        """(N, 3) environments -> (N, 3) in 0..1."""
        low = np.asarray(self.low)
        return np.asarray((np.atleast_2d(environments) - low) / (np.asarray(self.high) - low))

    def to_environment(self, unit: npt.ArrayLike) -> Floats:
        """(N, 3) in 0..1 -> (N, 3) environments."""
        low = np.asarray(self.low)
        return np.asarray(low + np.atleast_2d(unit) * (np.asarray(self.high) - low))


@dataclass(frozen=True, eq=False)
class Observation:
    """One stable trial: environment (3,), Re Z at F frequencies [N s/m] and its standard deviation (F,), 0 if exact."""

    environment: Floats
    resistance: Floats
    sd: Floats


@dataclass(frozen=True, eq=False)
class Surrogate:
    """The fit: n trials at `unit` (n, 3), `slopes` (F, 4) of (1, K, B, M), `weights` (F, n) of the rest; G = 1 or F:
    `inverse` (G, n, n) of the covariance, `spread` (G, 4, 4) covariance of the slopes. `length` and `amplitude` of the process."""

    box: Box
    unit: Floats
    slopes: Floats
    weights: Floats
    inverse: Floats
    spread: Floats
    length: float
    amplitude: float


def fit(box: Box, trials: Sequence[Observation]) -> Surrogate:
    """Surrogate of `trials`, at least four that span the box. AnalysisError for fewer or for unlike spectra."""
    if len(trials) < 4 or len({trial.resistance.size for trial in trials}) != 1:
        raise AnalysisError(f"{len(trials)} trials: at least four with spectra on the same frequencies are needed to begin")
    unit = box.to_unit([trial.environment for trial in trials])
    values = np.stack([trial.resistance for trial in trials])
    noise = np.stack([trial.sd for trial in trials]) ** 2
    affine = np.column_stack((np.ones(len(unit)), unit))
    if np.linalg.matrix_rank(affine) < 4:
        raise AnalysisError("the first trials lie in a plane: vary K, B and M each at least once")
    length, amplitude = _likeliest(unit, affine, values, noise.mean(axis=1))
    kernel = amplitude**2 * (_kernel(unit, unit, length) + _NUGGET * np.eye(len(unit)))
    diagonal = noise.T if noise.any() else np.zeros((1, len(unit)))
    inverse = np.asarray(np.linalg.inv(kernel + diagonal[:, :, None] * np.eye(len(unit))), np.float64)
    spread = np.asarray(np.linalg.inv(affine.T @ inverse @ affine), np.float64)
    by_frequency = values.T[:, :, None]
    slopes = spread @ (affine.T @ (inverse @ by_frequency))
    weights = inverse @ (by_frequency - affine @ slopes)
    return Surrogate(box, unit, slopes[:, :, 0], weights[:, :, 0], inverse, spread, length, amplitude)


def resistance(found: Surrogate, environments: npt.ArrayLike) -> Floats:
    """Expected Re Z (N, F) [N s/m]."""
    return _at_unit(found, found.box.to_unit(environments))


def margin(found: Surrogate, environments: npt.ArrayLike) -> Floats:
    """Expected least Re Z over the frequencies (N,) [N s/m]."""
    unit = found.box.to_unit(environments)
    parts = [unit[first : first + _TOGETHER] for first in range(0, len(unit), _TOGETHER)]
    return np.concatenate([_at_unit(found, part).min(axis=1) for part in parts])


def margin_sd(found: Surrogate, environments: npt.ArrayLike) -> Floats:
    """Standard deviation (N,) of Re Z at the frequency where it is least [N s/m]."""
    unit = found.box.to_unit(environments)
    worst = np.argmin(_at_unit(found, unit), axis=1) if len(found.inverse) > 1 else np.zeros(len(unit), np.int64)
    near = found.amplitude**2 * _kernel(unit, found.unit, found.length)
    gained = np.einsum("ni,nij->nj", near, found.inverse[worst])
    missed = np.column_stack((np.ones(len(unit)), unit)) - gained @ np.column_stack((np.ones(len(found.unit)), found.unit))
    variance = found.amplitude**2 - (gained * near).sum(axis=1) + np.einsum("ni,nij,nj->n", missed, found.spread[worst], missed)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _at_unit(found: Surrogate, unit: Floats) -> Floats:
    near = found.amplitude**2 * _kernel(unit, found.unit, found.length)
    return np.asarray(found.slopes[:, 0] + unit @ found.slopes[:, 1:].T + near @ found.weights.T)


def _kernel(one: Floats, other: Floats, length: float) -> Floats:
    square = ((one[:, None] - other) ** 2).sum(axis=2)
    return np.asarray(np.exp(-0.5 * square / length**2))


def _likeliest(unit: Floats, affine: Floats, values: Floats, noise: Floats) -> tuple[float, float]:
    """(length, amplitude) of greatest restricted likelihood, all frequencies together with the trials' mean noise (n,)."""
    rest = values - affine @ np.linalg.lstsq(affine, values, rcond=None)[0]
    scale = float(np.sqrt(np.mean(rest**2) * len(unit) / max(1, len(unit) - 4))) + _LEAST
    if len(unit) < FEW:
        return FIRST_LENGTH, scale
    return min(_matched(unit, affine, values, noise, length, scale) for length in LENGTHS)[1:]


def _matched(
    unit: Floats, affine: Floats, values: Floats, noise: Floats, length: float, amplitude: float
) -> tuple[float, float, float]:
    """(misfit, length, amplitude) with the amplitude at which the whitened residual has variance 1; exact without noise."""
    for _ in range(_ROUNDS):
        misfit, variance = _misfit(unit, affine, values, noise, length, amplitude)
        amplitude = max(amplitude * float(np.sqrt(variance)), _LEAST)
    return misfit, length, amplitude


def _misfit(unit: Floats, affine: Floats, values: Floats, noise: Floats, length: float, amplitude: float) -> tuple[float, float]:
    """Negative restricted log-likelihood per frequency, and variance of the whitened residual."""
    covariance = amplitude**2 * (_kernel(unit, unit, length) + _NUGGET * np.eye(len(unit))) + np.diag(noise)
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, np.column_stack((affine, values)))
    basis, triangle = np.linalg.qr(white[:, :4])
    left = white[:, 4:] - basis @ (basis.T @ white[:, 4:])
    square = float((left**2).sum() / values.shape[1])
    logs = np.log(np.diag(root)).sum() + np.log(np.abs(np.diag(triangle))).sum()
    return float(0.5 * square + logs), square / (len(unit) - 4)
