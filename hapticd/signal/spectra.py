"""`spa`: Blackman-Tukey spectra with a Hann lag window, of a record at once or while it arrives.

The definition is that of MATLAB's `spa`; `impedance` computes Z from the spectra. Velocity u is the
input, force y the output, as in the paper (Weir, Colgate and Peshkin 2008, section 2.2):

    R_yu(t)   = 1/N sum_k y(k + t) u(k),  |t| <= M          biased covariances of the detrended
                                                            record
    W(t)      = (1 + cos(pi t / M)) / 2                     Hann lag window, W(0) = 1, W(+-M) = 0
    Phi_yu(w) = sum_t W(t) R_yu(t) e^(-iwt)                 no sampling interval, no 1/(2 pi)
    C         = sum W^2 = 3 M / 4                           C/N: relative variance of a spectrum
                                                            inside the band

(Ljung, System Identification, 2nd ed. 1999, section 6.4. Older MATLAB help calls this window
Hamming.) `covariances` computes the covariances. 90 s at 4 kHz with the paper's M = 2048 give 2.6
Hz bandwidth and 469 degrees of freedom; at coherence 0.9 that is 0.9 degrees and 1.5 %.

Because W(+-M) = 0, the M + 1 frequencies k/(2 M) of the sample rate, the lines, determine the whole
estimate. Values between them follow by trigonometric interpolation:

    Phi(w) = sum_k Phi_k D(w - w_k),   D(x) = sin(M x) / (2 M tan(x/2)),   k over a circle of 2 M

A band therefore extends from edge to edge (`Spectra.band`) although 2 Hz is not a line of the
paper's window.

Limitations:

- A record shorter than a few windows, or a spring below 1/(M T): the window smooths the steep
  spectrum and pulls the phase to 0.
- Channels that are not sampled together: a skew d turns the phase by 360 f d degrees. A velocity
  sampled at the instant at which a held force changes is such a skew. Record means of force and
  velocity over the same interval, as the board's probe does, or correct it (`corrected`).
- A drift: the window's side lobes, up to -0.03 of the value at 0 Hz, have their zeros on the lines
  but not between them.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from math import ceil, floor
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Complexes, Flags, Floats, Integers, lazy_property
from hapticd.core.errors import AnalysisError
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.signal.covariances import (
    NO_SAMPLES,
    Covariances,
    Sections,
    detrended,
    line_products,
    same_length,
)

__all__ = ["DEFAULT_LAG", "Spectra", "SpectralStream", "grid_frequencies", "spa"]

CHANNELS = ("frequency_hz", "velocity", "force", "cross")  # arrays (F,) of `Spectra`
NEAR = 1e-6  # of the spacing of the lines: a closer frequency is that line
LEFT = 0.5  # of the smaller power of two lines: the minimum between lines of a smooth spectrum


DEFAULT_LAG = 2048  # Weir, Colgate and Peshkin 2008, section 2.2: "a window length of 2048 points"


@dataclass(frozen=True, slots=True)
class ChannelFaults:
    """Known and corrected faults of the recorded channels, as the arguments of `corrected`."""

    skew_s: float = 0.0
    high_pass_hz: float = 0.0

    def response(self, frequency_hz: Floats) -> Complexes:
        """Return the response of the velocity channel (F,); 1 at 0 Hz."""
        f = frequency_hz
        one = np.ones(f.size, np.complex128)
        passed = np.divide(1j * f, self.high_pass_hz + 1j * f, out=one, where=f > 0.0)
        return np.asarray(np.exp(2j * np.pi * f * self.skew_s) * passed)


@dataclass(frozen=True, eq=False)
class Spectra:
    """Spectra of one trial at F frequencies. A one-sided density per hertz is 2 Phi / rate_hz."""

    frequency_hz: Floats
    velocity: Floats  # (F,) Phi_u, (m/s)^2
    force: Floats  # (F,) Phi_y, N^2
    cross: Complexes  # (F,) Phi_yu, N m/s
    rate_hz: float
    n_samples: int  # N of the record
    lag: int  # M of the window, samples
    port: str = "probe"  # where the velocity was measured
    taken_out: tuple[ChannelFaults, ...] = ()  # faults that were corrected, in order

    # plain averages, whose intervals hold even for few of them; those of a window need many
    exact: ClassVar[bool] = False
    # motion that is narrower than the window was resolved where it mattered (`resolved`)
    resolved: ClassVar[bool] = False

    @property
    def seconds(self) -> float:
        """Length of the record."""
        return self.n_samples / self.rate_hz

    @property
    def variance_factor(self) -> float:
        """Relative variance C / N of a spectrum inside the band."""
        return 0.75 * self.lag / self.n_samples

    @property
    def degrees_of_freedom(self) -> float:
        """Degrees of freedom nu = 2 N / C of each spectral value."""
        return 2.0 / self.variance_factor

    @property
    def bandwidth_hz(self) -> float:
        """Equivalent noise bandwidth, rate / C: values closer than this are not independent."""
        return self.rate_hz / (0.75 * self.lag)

    @property
    def lowest_hz(self) -> float:
        """Lowest frequency that the window resolves, 1/(M T)."""
        return self.rate_hz / self.lag

    @lazy_property
    def whole(self) -> bool:
        """Whether these are all lines of the window, which also determine the rest."""
        if self.exact or self.frequency_hz.size != self.lag + 1:
            return False
        return np.array_equal(self.frequency_hz, _lines(self.rate_hz, self.lag))

    def part(self, which: Flags | Integers | slice) -> "Spectra":
        """Return spectra at some of the frequencies, `which` (F,)."""
        return replace(self, **{name: getattr(self, name)[which] for name in CHANNELS})

    def band(self, band_hz: tuple[float, float]) -> "Spectra":
        """Return spectra from `band_hz[0]` to `band_hz[1]`, both included; an end between lines is
        interpolated exactly.

        An end may have lost its power to the side lobes of a drift or of a steep spectrum. The next
        line outside the band then replaces it, so that the band has no gap, or nothing if that line
        is below `lowest_hz`. Spectra that are not `whole` return the frequencies that they have
        inside. AnalysisError for an end outside 0..rate/2.
        """
        ends_hz = float(band_hz[0]), float(band_hz[1])
        if ends_hz not in self._bands:
            self._bands[ends_hz] = self._cut(ends_hz)
        return self._bands[ends_hz]

    @lazy_property
    def _bands(self) -> "dict[tuple[float, float], Spectra]":
        """Cache of bands by their ends [Hz]."""
        return {}

    def _cut(self, band_hz: tuple[float, float]) -> "Spectra":
        """See `band`."""
        if not self.whole:
            return self.part((self.frequency_hz >= band_hz[0]) & (self.frequency_hz <= band_hz[1]))
        _inside(np.asarray(band_hz, np.float64), self.rate_hz)
        _, first = lines_beside(band_hz[0], self.rate_hz, self.lag)
        last, _ = lines_beside(band_hz[1], self.rate_hz, self.lag)
        after = self._edge(band_hz[1], 1) if band_hz[1] > band_hz[0] else []
        return _joined([*self._edge(band_hz[0], 0), self.part(slice(first, last + 1)), *after])

    def _edge(self, frequency_hz: float, outside: int) -> "list[Spectra]":
        """Return the spectra at an end of a band between lines; if it has no power of its own, the
        line below it (`outside` = 0) or above it (1).
        """
        beside = lines_beside(frequency_hz, self.rate_hz, self.lag)
        if beside[0] == beside[1]:
            return []
        found = self._between(frequency_hz)
        lines = self.part(np.array(beside))
        channels = ((found.velocity, lines.velocity), (found.force, lines.force))
        if all(own >= LEFT * both.min() for own, both in channels):
            return [found]
        instead = lines.part(slice(outside, outside + 1))
        return [instead] if instead.frequency_hz[0] >= self.lowest_hz else []

    def _between(self, frequency_hz: float) -> "Spectra":
        """Return the spectra at a frequency between lines: interpolated as recorded, then corrected
        as these are.
        """
        even, odd = _weights(self.lag, frequency_hz * 2.0 * self.lag / self.rate_hz)
        raw = _distorted(self)
        found = replace(
            raw,
            frequency_hz=np.array([frequency_hz]),
            velocity=np.maximum([even @ raw.velocity], 0.0),
            force=np.maximum([even @ raw.force], 0.0),
            cross=np.array([complex(even @ raw.cross.real, odd @ raw.cross.imag)]),
        )
        for channel in self.taken_out:
            found = _corrected(found, channel)
        return found

    @property
    def smoothing_hz2(self) -> float:
        """Second moment s^2 of the window in frequency [Hz^2]: it changes a curved spectrum by half
        of the second derivative times s^2.
        """
        return 0.125 * (self.rate_hz / self.lag) ** 2

    @property
    def span(self) -> str:
        """Description of the interval of analysis."""
        return f"window of {self.lag} samples"

    @property
    def covers(self) -> str:
        """Description of the errors that the intervals cover."""
        return (
            "the random error of a record of this length; not what the window smooths, which is"
            " named where it shows"
        )

    @lazy_property
    def coherence(self) -> Floats:
        """Coherence g2 (F,), between 0 and 1; 0 where a channel has no power. Read-only: all
        callers share the array.
        """
        power = self.velocity * self.force
        square = self.cross.real**2 + self.cross.imag**2
        found = np.divide(square, power, out=np.zeros_like(power), where=power > 0.0).clip(0.0, 1.0)
        found.flags.writeable = False
        return found


def spectra(
    covariances: Covariances, rate_hz: float, frequency_hz: Floats | None = None
) -> Spectra:
    """Return the windowed transform of `covariances` at `frequency_hz` (F,), by default at k
    rate/(2 M), k = 0..M.
    """
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


def corrected(trial: Spectra, skew_s: float = 0.0, high_pass_hz: float = 0.0) -> Spectra:
    """Return `trial` as if its channels had been sampled together and the velocity channel reached
    down to 0 Hz.

    `skew_s`: time from the force to the velocity of one sample. `high_pass_hz`: corner of a
    first-order high-pass in the velocity channel; the value at 0 Hz does not change. If both are 0,
    `trial` itself is returned. The hold of the force and the averaging of the velocity are not
    faults: predictions are compared as they would be recorded (`loop`).
    """
    if not (skew_s or high_pass_hz):
        return trial
    return _corrected(trial, ChannelFaults(skew_s, high_pass_hz))


def _corrected(trial: Spectra, channel: ChannelFaults) -> Spectra:
    response = channel.response(trial.frequency_hz)
    return replace(
        trial,
        velocity=trial.velocity / np.abs(response) ** 2,
        cross=trial.cross / response.conj(),
        taken_out=(*trial.taken_out, channel),
    )


def _distorted(trial: Spectra) -> Spectra:
    """Return the spectra as recorded: only those are a sum of covariances inside the window."""
    for channel in trial.taken_out:
        response = channel.response(trial.frequency_hz)
        velocity = trial.velocity * np.abs(response) ** 2
        trial = replace(trial, velocity=velocity, cross=trial.cross * response.conj())
    return replace(trial, taken_out=())


def _joined(parts: list[Spectra]) -> Spectra:
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in CHANNELS
    }
    return replace(parts[0], **joined)


@lru_cache(maxsize=64)
def _weights(lag: int, place: float) -> tuple[Floats, Floats]:
    """Return the weights of the lines' real and imaginary parts (M + 1,) in the value at `place`,
    which is in units of lines and between two of them.

    Lines of negative frequency have the conjugate values, so each weight combines D of a line and
    of its mirror image.
    """
    own = _kernel(lag, place)
    mirrored = _kernel(lag, -place)
    mirrored[[0, lag]] = 0.0  # 0 Hz and half the sample rate are their own mirror images
    return own + mirrored, own - mirrored


def _kernel(lag: int, place: float) -> Floats:
    """Return D (M + 1,) of the module docstring at `place` - k, k = 0..M. The sine of the distance
    to the nearest line preserves its digits.
    """
    k = np.arange(lag + 1)
    line = round(place)
    sine = (1.0 - 2.0 * ((line - k) % 2)) * np.sin(np.pi * (place - line))
    turn = place - k
    turn -= 2 * lag * np.round(turn / (2 * lag))
    return np.asarray(sine / (2 * lag * np.tan(np.pi * turn / (2 * lag))))


def grid_frequencies(rate_hz: float, lag: int) -> Floats:
    """Return k rate/(2 M), k = 0..M: the frequencies that determine the whole estimate (M + 1,)."""
    return np.asarray(np.arange(lag + 1) * (0.5 * rate_hz / lag), np.float64)


_lines = lru_cache(maxsize=8)(grid_frequencies)


def lines_beside(frequency_hz: float, rate_hz: float, lag: int) -> tuple[int, int]:
    """Return the numbers of the lines at or below and at or above a frequency; equal on a line."""
    place = frequency_hz * (2.0 * lag / rate_hz)
    return floor(place + NEAR), ceil(place - NEAR)


def on_the_grid(ahead: Floats, behind: Floats) -> Complexes:
    """Return the windowed transform (..., M + 1) of covariances at lags 0..M and 0..-M, both (...,
    M + 1), on `grid_frequencies`.
    """
    lag = ahead.shape[-1] - 1
    circular = np.zeros((*ahead.shape[:-1], 2 * lag))
    window = _window(lag)
    np.multiply(ahead[..., :lag], window[:lag], out=circular[..., :lag])
    np.multiply(
        behind[..., lag - 1 : 0 : -1], window[lag - 1 : 0 : -1], out=circular[..., lag + 1 :]
    )
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
        raise AnalysisError(
            f"frequencies: a list inside 0..{0.5 * rate_hz:g} Hz, half the sample rate, is needed"
        )
    return frequency_hz


def spa(
    force_n: npt.ArrayLike,
    velocity_m_per_s: npt.ArrayLike,
    rate_hz: float = PROBE_RATE_HZ,
    lag: int = DEFAULT_LAG,
    frequency_hz: npt.ArrayLike | None = None,
    detrend: bool = True,
) -> Spectra:
    """Return the spectra of a record, force and velocity (N,) float64, as MATLAB's
    `spa(iddata(force, velocity), lag)` computes them.

    `frequency_hz` (F,): any frequencies up to rate/2, by default k rate/(2 lag), k = 0..lag.
    `detrend` removes a straight line from both channels first. AnalysisError for records that are
    unequal, short (N <= lag) or not finite.
    """
    force, velocity = (
        np.ascontiguousarray(signal, np.float64) for signal in (force_n, velocity_m_per_s)
    )
    same_length(force, velocity)
    _long_enough(force.size, lag)
    sums = Sections(lag)
    if detrend:
        sums.add(detrended(force), detrended(velocity))
    else:
        sums.add(force, velocity)
    return spectra(
        _finite(sums.covariances()),
        rate_hz,
        None if frequency_hz is None else np.asarray(frequency_hz, np.float64),
    )


class SpectralStream:
    """`spa` for a record that arrives in blocks: memory O(lag), spectra of all samples so far at
    any time.
    """

    def __init__(self, rate_hz: float = PROBE_RATE_HZ, lag: int = DEFAULT_LAG) -> None:
        self._sums = Sections(lag)
        self._rate_hz = rate_hz
        self._force = self._velocity = NO_SAMPLES
        self._first = 0.0, 0.0  # samples

    @property
    def n_samples(self) -> int:
        """Samples taken so far."""
        return self._sums.n_samples

    def add(self, force_n: npt.ArrayLike, velocity_m_per_s: npt.ArrayLike) -> None:
        """Append a block, both (n,) float64 of any length. AnalysisError for unequal lengths."""
        force, velocity = (
            np.ascontiguousarray(signal, np.float64) for signal in (force_n, velocity_m_per_s)
        )
        if not self.n_samples and force.size and velocity.size:
            self._first = force[0], velocity[0]
        # otherwise the square of an offset dominates the sums
        force = force - self._first[0]
        velocity = velocity - self._first[1]
        self._sums.add(force, velocity)
        self._force = self._force.extended(force, self._sums.lag)
        self._velocity = self._velocity.extended(velocity, self._sums.lag)

    def spectra(self) -> Spectra:
        """Return the spectra of the whole record so far, as `spa` does. AnalysisError if it is not
        longer than the lag.
        """
        lag = self._sums.lag
        _long_enough(self.n_samples, lag)
        raw = self._sums.covariances()
        u = self._velocity
        y = self._force
        covariances = Covariances(
            raw.velocity - line_products(u, u, lag),
            raw.force - line_products(y, y, lag),
            raw.forward - line_products(y, u, lag),
            raw.backward - line_products(u, y, lag),
            raw.n_samples,
        )
        return spectra(_finite(covariances), self._rate_hz)


def _long_enough(n_samples: int, lag: int) -> None:
    if lag < 2:
        raise AnalysisError(
            f"lag {lag}: a window of at least 2 samples is needed; the paper's has {DEFAULT_LAG}"
        )
    if n_samples <= lag:
        raise AnalysisError(
            f"record of {n_samples} samples: more than the window of {lag} are needed; record"
            " longer or take a smaller lag"
        )


def _finite(covariances: Covariances) -> Covariances:
    if not np.isfinite(covariances.velocity[0] + covariances.force[0] + covariances.forward[0]):
        raise AnalysisError(
            "the record holds values that are not finite; drop or repair them before the analysis"
        )
    return covariances
