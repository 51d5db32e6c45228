"""How far "spa" reads |Z| low where the velocity has little power: below the resonance of a lightly
damped spring.

There the spring lets through v ~ f / K, so the velocity's spectrum is steep, and small beside that
of the resonance. Two things fill it up, and Z = Phi_yu / Phi_u shrinks as they do:

    window      covariances at lag t are multiplied by W(t): the spectrum is smoothed, and |Z| of a
                spring shrinks by s^2 / (f^2 + s^2), 5 % at 3 Hz for M = 2048
    record      those of a record of N samples are multiplied by 1 - |t|/N as well: a sharp
                resonance leaks down to the band edge, whatever the window

What they did once is seen by doing it once more (twicing, Tukey 1977), which is a product with the
covariances. The phase is pulled towards 0 as well, and can hide a little activity. A longer window
cures the first, a longer record the second, whole periods (`periodic`) both; "h_force" leaves Phi_u
out, which is what is filled up.

What would break it: spectra that are not on the window's own grid, which do not hold the
covariances (nothing is said).
"""

import numpy as np

from hapticd.analysis.arrays import Complexes
from hapticd.analysis.diagnostics import Finding
from hapticd.analysis.impedance import Estimator, impedance
from hapticd.analysis.spectra import Spectra
from hapticd.analysis.unexplained import LOW_COHERENCE

LOW_SHARE = 0.05  # of |Z|, from which it is named
CERTAINTY = 3.0  # standard deviations of |Z|


def shrinkage(trial: Spectra, estimator: Estimator = "spa") -> Complexes:
    """What window and ends of the record did to Z, as the factor (F,) by which doing it again
    changes it; 1 if it is unknown.
    """
    if trial.frequency_hz.size != trial.lag + 1 or trial.exact:
        return np.ones(trial.frequency_hz.size, np.complex128)
    rows = np.stack((trial.velocity + 0j, trial.force + 0j, trial.cross))
    lags = np.abs(np.fft.fftfreq(2 * trial.lag, 0.5 / trial.lag))
    again = 0.5 * (1.0 + np.cos(np.pi * lags / trial.lag)) * (1.0 - lags / trial.n_samples)
    velocity, force, cross = np.fft.rfft(np.fft.irfft(rows, axis=1) * again, axis=1)
    twice = Spectra(
        trial.frequency_hz,
        np.maximum(velocity.real, 0.0),
        np.maximum(force.real, 0.0),
        cross,
        trial.rate_hz,
        trial.n_samples,
        trial.lag,
    )
    z, changed = (impedance(one, estimator).impedance_ns_per_m for one in (trial, twice))
    return np.asarray(np.divide(changed, z, out=np.ones_like(z), where=np.isfinite(z) & (z != 0.0)))


def leakage_findings(
    trial: Spectra, band_hz: tuple[float, float], estimator: Estimator = "spa"
) -> tuple[Finding, ...]:
    """|Z| that is read low inside `band_hz` by more than a twentieth, and more than chance does.

    The finding names the range of frequencies.

    Where there is little coherence, that is what is named (`unexplained`).
    """
    inside = (trial.frequency_hz >= band_hz[0]) & (trial.frequency_hz <= band_hz[1])
    factor = shrinkage(trial, estimator)[inside]
    low = 1.0 - np.abs(factor)
    spread = impedance(trial, estimator).relative_sd[inside]
    named = (
        (low > LOW_SHARE) & (low > CERTAINTY * spread) & (trial.coherence[inside] > LOW_COHERENCE)
    )
    if not named.any():
        return ()
    f = trial.frequency_hz[inside]
    worst = int(np.argmax(np.where(named, low, 0.0)))
    message = (
        f"leakage: |Z| reads about {100 * low[worst]:.2g} % low at {f[worst]:.3g} Hz and the phase"
        f" is pulled {abs(np.degrees(np.angle(factor[worst]))):.2g} deg towards 0, from"
        f" {f[named][0]:.3g} to {f[named][-1]:.3g} Hz more than {100 * LOW_SHARE:g} %: a window of"
        f" {trial.lag} samples does not resolve so lightly damped a motion; take a longer window"
        " (--lag), h_force, a multisine, or begin the band higher"
    )
    return (Finding("leakage", message),)
