"""The Gaussian process behind `surrogate`: its covariance, and the length and amplitude that trials
make likeliest.

    y_f = trend c_f + g_f + e,   g ~ GP(amplitude^2 exp(-d^2 / 2 length^2)),
    g alike at all frequencies, e the trial's own noise

The trend's coefficients are integrated out (restricted likelihood: Patterson and Thompson 1971), so
four trials that a plane fits exactly do not make everything certain. Without noise the amplitude
has a closed form at each length; with noise both are tried on a coarse grid, which is as fine as
some dozens of trials can tell.

What would break it: fewer than `FEW` trials, where likelihood has nothing to say; then the length
is a usual one.
"""

import numpy as np

from hapticd.analysis.arrays import Floats

LENGTHS = (0.15, 0.2, 0.3, 0.45, 0.7, 1.2)  # of the unit box
SHARES = (
    0.03,
    0.1,
    0.2,
    0.35,
    0.6,
    1.0,
)  # of the scatter of what is left over that may be the process and not noise
SOME = 12  # frequencies whose likelihood decides where trials are noisy
FEW = 8  # trials below which likelihood has nothing to say
FIRST_LENGTH = 0.45
_NUGGET = 1e-6  # of amplitude^2: keeps the matrices regular
_LEAST = 1e-12  # N s/m of amplitude
_ROUNDS = 4


def kernel(one: Floats, other: Floats, length: float) -> Floats:
    """exp(-d^2 / 2 length^2) (N, n) between `one` (N, 3) and `other` (n, 3)."""
    square = ((one[:, None] - other) ** 2).sum(axis=2)
    return np.asarray(np.exp(-0.5 * square / length**2))


def precision(
    unit: Floats, trend: Floats, noise: Floats, length: float, amplitude: float
) -> tuple[Floats, Floats]:
    """Inverse (G, n, n) of the covariance of n trials at `unit` (n, 3) with `noise` (G, n), and
    covariance (G, t, t) of the slopes of `trend` (n, t). G = 1 where all frequencies are alike,
    else F.
    """
    process = amplitude**2 * (kernel(unit, unit, length) + _NUGGET * np.eye(len(unit)))
    inverse = np.asarray(np.linalg.inv(process + noise[:, :, None] * np.eye(len(unit))), np.float64)
    return inverse, np.asarray(np.linalg.inv(trend.T @ inverse @ trend), np.float64)


def likeliest(unit: Floats, trend: Floats, values: Floats, noise: Floats) -> tuple[float, float]:
    """(length, amplitude) of greatest restricted likelihood; `values` (F, n), `noise` (G, n)."""
    rest = values.T - trend @ np.linalg.lstsq(trend, values.T, rcond=None)[0]
    scale = (
        float(np.sqrt(np.mean(rest**2) * len(unit) / max(1, len(unit) - trend.shape[1]))) + _LEAST
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
    """(misfit, length, amplitude) with the amplitude at which the whitened residual has
    variance 1: exact without noise.
    """
    for _ in range(_ROUNDS):
        misfit, variance = _misfit(unit, trend, values, noise, length, amplitude)
        amplitude = max(amplitude * float(np.sqrt(variance)), _LEAST)
    return misfit, length, amplitude


def _misfit(
    unit: Floats, trend: Floats, values: Floats, noise: Floats, length: float, amplitude: float
) -> tuple[float, float]:
    """Negative restricted log-likelihood per frequency, and variance of the whitened residual."""
    inverse, spread = precision(unit, trend, noise, length, amplitude)
    y = values[:, :, None]
    white = inverse @ (y - trend @ (spread @ (trend.T @ (inverse @ y))))
    square = max(0.0, float((y * white).sum()) / len(values))
    logs = np.linalg.slogdet(inverse)[1].mean() + np.linalg.slogdet(spread)[1].mean()
    return 0.5 * (square - float(logs)), square / (len(unit) - trend.shape[1])
