"""`spa`: from a record of force and velocity to its spectra, at once or while it arrives.

The definition is in `spectra`, the arithmetic in `sections`. 90 s at 4 kHz with M = 2048 give 2.6
Hz bandwidth and 469 degrees of freedom; at coherence 0.9 that is 0.9 degrees and 1.5 %.

What would break it: velocity sampled at the instant at which a held force changes. Record what the
board's probe records, the means of force and velocity over the same interval; or correct the skew
(`spectra.corrected`).
"""

import numpy as np
import numpy.typing as npt

from hapticd.analysis.arrays import Floats
from hapticd.analysis.kernels import kernels
from hapticd.analysis.sections import TOGETHER, Covariances, Sections, same_length
from hapticd.analysis.spectra import Spectra, spectra
from hapticd.analysis.trend import NO_SAMPLES, line_products
from hapticd.errors import AnalysisError
from hapticd.units import PROBE_RATE_HZ

DEFAULT_LAG = 2048  # Weir, Colgate and Peshkin 2008, section 2.2: "a window length of 2048 points"


def spa(
    force_n: npt.ArrayLike,
    velocity_m_per_s: npt.ArrayLike,
    rate_hz: float = PROBE_RATE_HZ,
    lag: int = DEFAULT_LAG,
    frequency_hz: npt.ArrayLike | None = None,
    detrend: bool = True,
) -> Spectra:
    """Spectra of a record, force and velocity (N,) float64, as MATLAB's `spa(iddata(force,
    velocity), lag)` computes them.

    `frequency_hz` (F,): any frequencies up to rate/2, by default k rate/(2 lag), k = 0..lag.
    `detrend` takes a straight line out of both channels first. AnalysisError for unequal, short (N
    <= lag) or not finite records.
    """
    force, velocity = (
        np.ascontiguousarray(signal, np.float64) for signal in (force_n, velocity_m_per_s)
    )
    same_length(force, velocity)
    _long_enough(force.size, lag)
    sums = Sections(lag)
    if detrend:
        _add_detrended(sums, force, velocity)
    else:
        sums.add(force, velocity)
    return spectra(
        _finite(sums.covariances()),
        rate_hz,
        None if frequency_hz is None else np.asarray(frequency_hz, np.float64),
    )


class SpectralStream:
    """The same for a record that arrives in blocks: memory O(lag), spectra of all so far at any
    time.
    """

    def __init__(
        self, rate_hz: float = PROBE_RATE_HZ, lag: int = DEFAULT_LAG, detrend: bool = True
    ) -> None:
        self._sums = Sections(lag)
        self._rate_hz = rate_hz
        self._detrend = detrend
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
        if self._detrend and force.size and velocity.size:
            if not self.n_samples:
                self._first = force[0], velocity[0]
            # else the square of an offset drowns the rest
            force = force - self._first[0]
            velocity = velocity - self._first[1]
        self._sums.add(force, velocity)
        if self._detrend:
            self._force = self._force.extended(force, self._sums.lag)
            self._velocity = self._velocity.extended(velocity, self._sums.lag)

    def spectra(self, frequency_hz: Floats | None = None) -> Spectra:
        """Spectra of the whole record so far, as `spa` gives them. AnalysisError if it is not
        longer than the lag.
        """
        _long_enough(self.n_samples, self._sums.lag)
        return spectra(_finite(self._covariances()), self._rate_hz, frequency_hz)

    def _covariances(self) -> Covariances:
        raw = self._sums.covariances()
        lag = self._sums.lag
        u = self._velocity
        y = self._force
        if not self._detrend:
            return raw
        return Covariances(
            raw.velocity - line_products(u, u, lag),
            raw.force - line_products(y, y, lag),
            raw.forward - line_products(y, u, lag),
            raw.backward - line_products(u, y, lag),
            raw.n_samples,
        )


def _add_detrended(sums: Sections, force: Floats, velocity: Floats) -> None:
    """Block by block, so that no copy of the record is made."""
    size, (fitted_line, take_line_out) = (
        max(1, TOGETHER // sums.lag) * sums.lag,
        (kernels().fitted_line, kernels().take_line_out),
    )
    lines = [(signal, *fitted_line(signal), np.empty(size)) for signal in (force, velocity)]
    for start in range(0, force.size, size):
        count = min(size, force.size - start)
        for signal, value, slope, block in lines:
            take_line_out(
                signal[start : start + count], value + slope * start, slope, block[:count]
            )
        sums.add(lines[0][-1][:count], lines[1][-1][:count])


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
