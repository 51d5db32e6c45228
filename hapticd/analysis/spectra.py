"""Blackman-Tukey spectra: the definition of MATLAB's `spa`. The impedance that follows from them is in `impedance`.

Velocity u is the input, force y the output, as in the paper (Weir, Colgate and Peshkin 2008, section 2.2):

    R_yu(t)   = 1/N sum_k y(k + t) u(k),  |t| <= M          biased covariances of the detrended record
    W(t)      = (1 + cos(pi t / M)) / 2                     Hann lag window, W(0) = 1, W(+-M) = 0
    Phi_yu(w) = sum_t W(t) R_yu(t) e^(-iwt)                 no sampling interval, no 1/(2 pi)
    C         = sum W^2 = 3 M / 4                           C/N: relative variance of a spectrum inside the band

(Ljung, System Identification, 2nd ed. 1999, section 6.4. Older MATLAB help calls this window Hamming.) Because W(+-M) = 0, the
M + 1 frequencies k/(2 M) of the sample rate hold the whole estimate; every other is its exact trigonometric interpolation.

What would break it: a record shorter than a few windows, a spring below 1/(M T) (the window smooths the steep spectrum and
pulls the phase to 0), channels not sampled together (a skew d turns the phase by 360 f d degrees; `corrected` undoes it).
"""

from dataclasses import dataclass, replace

import numpy as np

from hapticd.analysis.arrays import Complexes, Flags, Floats
from hapticd.analysis.sections import Covariances
from hapticd.errors import AnalysisError


@dataclass(frozen=True, eq=False)
class Spectra:
    """Spectra of one trial at `frequency_hz` (F,): `velocity` [(m/s)^2], `force` [N^2] float64, `cross` Phi_yu [N m/s] complex128.

    A one-sided density per hertz is 2 Phi / rate_hz. `port` names where velocity was measured.
    """

    frequency_hz: Floats
    velocity: Floats
    force: Floats
    cross: Complexes
    rate_hz: float
    n_samples: int
    lag: int
    port: str = "probe"

    @property
    def variance_factor(self) -> float:
        """C / N: relative variance of a spectrum inside the band."""
        return 0.75 * self.lag / self.n_samples

    @property
    def degrees_of_freedom(self) -> float:
        """nu = 2 N / C of each spectral value."""
        return 2.0 / self.variance_factor

    @property
    def bandwidth_hz(self) -> float:
        """Equivalent noise bandwidth rate / C: values closer than this are not independent."""
        return self.rate_hz / (0.75 * self.lag)

    @property
    def lowest_hz(self) -> float:
        """1/(M T): below it nothing can be said."""
        return self.rate_hz / self.lag

    def part(self, which: Flags) -> "Spectra":
        """Those at some of the frequencies, `which` (F,)."""
        f, cross = self.frequency_hz[which], self.cross[which]
        return replace(self, frequency_hz=f, velocity=self.velocity[which], force=self.force[which], cross=cross)

    @property
    def smoothing_hz2(self) -> float:
        """s^2, second moment of the window in frequency: what is curved is changed by half of its second derivative times that."""
        return 0.125 * (self.rate_hz / self.lag) ** 2

    @property
    def exact(self) -> bool:
        """Whether these are plain averages, whose intervals hold for few of them as well; a window's need many."""
        return False

    @property
    def span(self) -> str:
        """What the values were taken over, in words."""
        return f"window of {self.lag} samples"

    @property
    def coherence(self) -> Floats:
        """g2 (F,), between 0 and 1; 0 where a channel has no power."""
        power = self.velocity * self.force
        square = self.cross.real**2 + self.cross.imag**2
        return np.clip(np.divide(square, power, out=np.zeros_like(power), where=power > 0.0), 0.0, 1.0)


def spectra(covariances: Covariances, rate_hz: float, frequency_hz: Floats | None = None) -> Spectra:
    """Windowed transform of `covariances` at `frequency_hz` (F,), by default at k rate/(2 M), k = 0..M."""
    lag = covariances.velocity.size - 1
    ahead = np.stack((covariances.velocity, covariances.force, covariances.forward))
    behind = np.stack((covariances.velocity, covariances.force, covariances.backward))
    if frequency_hz is None:
        f = grid_frequencies(rate_hz, lag)
        found = on_the_grid(ahead, behind)
    else:
        f = _inside(np.asarray(frequency_hz, np.float64), rate_hz)
        found = _anywhere(_window(lag) * ahead, _window(lag) * behind, 2.0 * np.pi * f / rate_hz)
    velocity, force = (np.maximum(row.real, 0.0) for row in found[:2])
    return Spectra(f, velocity, force, found[2], rate_hz, covariances.n_samples, lag)


def corrected(trial: Spectra, skew_s: float = 0.0, high_pass_hz: float = 0.0, interval_s: float = 0.0) -> Spectra:
    """`trial` as it had been with channels sampled together, a velocity channel down to 0 Hz, and instants instead of means.

    `skew_s`: the velocity is that of `skew_s` later than the force of the same sample. `high_pass_hz`: corner of a
    first-order high-pass in the velocity channel; the value at 0 Hz stays as it is. `interval_s`: the force was held, and the
    velocity averaged, over intervals of this length, which raises |Z| by 1/sinc(f interval_s)^2 and leaves the phase.
    """
    f = trial.frequency_hz
    passed = np.divide(1j * f, high_pass_hz + 1j * f, out=np.ones(f.size, np.complex128), where=f > 0.0)
    channel = np.exp(2j * np.pi * f * skew_s) * passed
    mean = np.sinc(f * interval_s) ** 2
    velocity = trial.velocity / (np.abs(channel) ** 2 * mean)
    return replace(trial, velocity=velocity, force=trial.force * mean, cross=trial.cross / channel.conj())


def grid_frequencies(rate_hz: float, lag: int) -> Floats:
    """k rate/(2 M), k = 0..M: the frequencies that hold the whole estimate (M + 1,)."""
    return np.asarray(np.arange(lag + 1) * (0.5 * rate_hz / lag), np.float64)


def on_the_grid(ahead: Floats, behind: Floats) -> Complexes:
    """Windowed transform (..., M + 1) of covariances at lags 0..M and 0..-M, both (..., M + 1), on `grid_frequencies`."""
    lag = ahead.shape[-1] - 1
    circular, window = np.zeros((*ahead.shape[:-1], 2 * lag)), _window(lag)
    np.multiply(ahead[..., :lag], window[:lag], out=circular[..., :lag])
    np.multiply(behind[..., lag - 1 : 0 : -1], window[lag - 1 : 0 : -1], out=circular[..., lag + 1 :])
    return np.fft.rfft(circular, axis=-1)


def _window(lag: int) -> Floats:
    return np.asarray(0.5 * (1.0 + np.cos(np.pi * np.arange(lag + 1) / lag)), np.float64)


def _anywhere(ahead: Floats, behind: Floats, angle: Floats) -> Complexes:
    turn = np.exp(-1j * np.outer(angle, np.arange(ahead.shape[1])))
    return np.asarray((turn @ ahead.T + turn.conj() @ behind.T).T - ahead[:, :1])


def _inside(frequency_hz: Floats, rate_hz: float) -> Floats:
    if (
        frequency_hz.ndim != 1
        or not frequency_hz.size
        or not np.all((frequency_hz >= 0.0) & (frequency_hz <= 0.5 * rate_hz * (1 + 1e-12)))
    ):
        raise AnalysisError(f"frequencies: a list inside 0..{0.5 * rate_hz:g} Hz, half the sample rate, is needed")
    return frequency_hz
