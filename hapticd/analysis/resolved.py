"""Z where the motion is narrower than the window: local polynomials on the record's own frequencies.

A resonance of a fraction of a hertz is averaged by the window with what is beside it, and leaks from there all over the band:
what the perturbation explains looks unexplained, |Z| reads low and the phase is pulled. The whole record resolves 1/(N T),
0.011 Hz for 90 s. With its transforms F of the force and V of the velocity, a linear device answers

    f F(f) = Q(f) V(f) + J(f),     Q = f Z

exactly: J holds what the motion before the first and after the last sample does, the record's own leakage (Pintelon,
Schoukens, Vandersteen and Barbe 2010, "Estimation of nonparametric noise and FRF models for multivariable systems", MSSP 24).
However sharply the velocity rises in a resonance, Z is smooth there, and Q of mass, damper and spring a polynomial of second
order. So about each frequency Q and J are polynomials of second order in f, found by least squares over

    3 / (M T), 5.9 Hz for the paper's window

where they vary by chance as much as what that window gives, Var = s^2 [(A^H A)^-1], with as many degrees of freedom. What is
left of the force, s^2, is what the perturbation does not explain, at the resolution of the record: nothing for a resonance
however narrow; most of it for a limit cycle, which goes on by itself, for its power is in the velocity and not in Q V.

What would break it: noise in the velocity, which shrinks |Z| as with "spa"; features of Z itself within 6 Hz, as from a light
part that resonates by itself: they are averaged, and counted as unexplained.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hapticd.analysis.arrays import Complexes, Flags, Floats, Integers
from hapticd.analysis.impedance import Estimator
from hapticd.analysis.leakage import leakage_findings
from hapticd.analysis.sections import same_length
from hapticd.analysis.spectra import Spectra
from hapticd.analysis.unexplained import LINE_WIDTH, line_of

ORDER = 2  # of both polynomials
TERMS = ORDER + 1
WIDTH = 3.0  # times 1/(M T): a parabola through the middle then has the variance of the window
ABOUT = 3 * LINE_WIDTH  # lines on each side of one that is not explained
TOGETHER = 64  # frequencies at once: 4 MB
TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, eq=False)
class Resolved(Spectra):
    """Spectra of a window in which lines, and the ends of a band, were replaced: their ratio is Z by local polynomials, their
    coherence gives its interval. Elsewhere they are the window's.
    """

    from_hz: float = 0.0
    to_hz: float = 0.0
    explained: float = 0.0  # share of the velocity's power at the lines that were replaced

    @property
    def whole(self) -> bool:
        """What was replaced is no sum of covariances inside the window."""
        return False

    @property
    def resolved(self) -> bool:
        """Yes."""
        return True

    @property
    def said(self) -> str:
        """How Z was found, in words."""
        return (
            f"motion narrower than the window of {self.lag} samples: judged again by the record's own frequencies, "
            f"{self.rate_hz / self.n_samples:.2g} Hz apart, by local polynomials {WIDTH * self.rate_hz / self.lag:.2g} Hz wide "
            f"from {self.from_hz:.3g} to {self.to_hz:.3g} Hz"
        )


def unresolved(trial: Spectra, band_hz: tuple[float, float], estimator: Estimator = "spa", linear: bool = False) -> Flags:
    """Which lines (F,) of a window's spectra need their record: all of a band that leaks, and those about a line that is not
    explained, with the band; none where the window resolves the motion. What a `linear` device leaves unexplained is the doing
    of the window and of the record's ends, wherever it is.
    """
    line = None if trial.resolved else line_of(trial)
    if trial.resolved or not (linear or line or leakage_findings(trial, band_hz, estimator)):
        return np.zeros(trial.frequency_hz.size, np.bool_)
    low_hz = max(trial.lowest_hz, band_hz[0] - trial.bandwidth_hz)  # what is read together with the edge
    needed = (trial.frequency_hz >= low_hz) & (trial.frequency_hz <= band_hz[1])
    if line is not None:
        needed[max(1, line.place - ABOUT) : line.place + ABOUT] = True
    return needed


def resolved(
    force_n: npt.ArrayLike,
    velocity_m_per_s: npt.ArrayLike,
    trial: Spectra,
    band_hz: tuple[float, float],
    estimator: Estimator = "spa",
    servo_rate_hz: float | None = None,
    linear: bool = False,
) -> Spectra:
    """`trial`, the spectra of that record (N,), or where its window does not resolve the motion `Resolved`.

    `servo_rate_hz`: of the law's samples, if known. `linear`: so is the device. AnalysisError for unequal lengths.
    """
    needed = unresolved(trial, band_hz, estimator, linear)
    if not needed.any():
        return trial
    force, velocity = (np.asarray(signal, np.float64) for signal in (force_n, velocity_m_per_s))
    same_length(force, velocity)
    again = np.union1d(trial.frequency_hz[needed], band_hz)
    z, variance, power, alone = _polynomials(force, velocity, trial, again, servo_rate_hz)
    share = 0.5 * trial.degrees_of_freedom * variance / np.maximum(np.abs(z) ** 2, TINY)
    explained = np.maximum(1.0 - alone, 0.0) / (1.0 + share)
    rest = ~np.isin(trial.frequency_hz, again)
    f = np.concatenate((trial.frequency_hz[rest], again))
    order = np.argsort(f)
    return Resolved(
        frequency_hz=f[order],
        velocity=np.concatenate((trial.velocity[rest], power))[order],
        force=np.concatenate((trial.force[rest], np.abs(z) ** 2 * power * (1.0 + share)))[order],
        cross=np.concatenate((trial.cross[rest], z * power))[order],
        rate_hz=trial.rate_hz,
        n_samples=trial.n_samples,
        lag=trial.lag,
        port=trial.port,
        from_hz=float(again[0]),
        to_hz=float(again[-1]),
        explained=float(power @ explained / power.sum()),
    )


def _polynomials(
    force: Floats, velocity: Floats, trial: Spectra, frequency_hz: Floats, servo_rate_hz: float | None
) -> tuple[Complexes, Floats, Floats, Floats]:
    """Z, its variance, the velocity's spectrum, and the power of J over that of the force (F,)."""
    bins_per_hz = force.size / trial.rate_hz
    half = max(2 * TERMS, round(0.5 * WIDTH * force.size / trial.lag))
    servo = 0 if servo_rate_hz is None else round(servo_rate_hz * bins_per_hz)
    whole = Record(np.fft.fft(force), np.fft.rfft(velocity), half, servo)
    places = np.clip(np.rint(frequency_hz * bins_per_hz).astype(np.int64), 1, force.size // 2)
    parts = [whole.fitted(some) for some in np.array_split(places, -(-places.size // TOGETHER))]
    z, variance, power, alone = (np.concatenate(column) for column in zip(*parts, strict=True))
    return z, variance, power / force.size, alone


@dataclass(frozen=True, eq=False)
class Record:
    """Transforms of a whole record: `force` (N,) of both signs, `velocity` (N/2 + 1,); bins of the fit and of the servo rate."""

    force: Complexes
    velocity: Complexes
    half: int
    servo: int

    def fitted(self, places: Integers) -> tuple[Complexes, Floats, Floats, Floats]:
        """Z, its variance, the mean |V|^2, and the power of J over that of the force about `places` (F,)."""
        bins = places[:, None] + np.arange(-self.half, self.half + 1)
        inside = (bins > 0) & (bins < self.velocity.size)
        at = np.where(inside, bins, 0)
        v = np.where(inside, self.velocity[at], 0.0)
        rising = inside * (bins / places[:, None])
        y = rising * self.force[at]
        powers = (np.arange(-self.half, self.half + 1) / self.half)[:, None] ** np.arange(TERMS)
        columns = np.concatenate((v[..., None] * powers, inside[..., None] * powers, rising[..., None] * self._images(at)), axis=2)
        size = np.sqrt((np.abs(columns) ** 2).sum(axis=1))
        columns /= size[:, None]
        conjugate = columns.conj().swapaxes(1, 2)
        inverse = np.linalg.inv(conjugate @ columns)
        found = inverse @ (conjugate @ y[..., None])
        left = (np.abs(y[..., None] - columns @ found) ** 2).sum(axis=(1, 2))
        freedom = np.maximum(inside.sum(axis=1) - columns.shape[2], 1)
        variance = left / freedom * inverse[:, 0, 0].real / size[:, 0] ** 2
        ends = (columns[:, :, TERMS : 2 * TERMS] @ found[:, TERMS : 2 * TERMS])[..., 0]
        alone = (np.abs(ends) ** 2).sum(axis=1) / (np.abs(y) ** 2).sum(axis=1)
        return found[:, 0, 0] / size[:, 0], variance, (np.abs(v) ** 2).sum(axis=1) / inside.sum(axis=1), alone

    def _images(self, at: Integers) -> Complexes:
        """The force at f + k times the servo rate (F, n, k); none where that is not known."""
        n = self.force.size
        at_rate = [self.force[(at + image) % n] for image in range(self.servo, n - 1, self.servo)] if self.servo else []
        return np.stack(at_rate, axis=2) if at_rate else np.empty((*at.shape, 0), np.complex128)
