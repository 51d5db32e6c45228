"""Z where the motion is narrower than the window: local polynomials on the record's frequencies.

A resonance of a fraction of a hertz is averaged by the window with what is beside it, and leaks
from there all over the band: what the perturbation explains looks unexplained, |Z| reads low and
the phase is pulled. The whole record resolves 1/(N T), 0.011 Hz for 90 s. With its transforms F of
the force and V of the velocity, a linear device answers

    f F(f) = Q(f) V(f) + J(f) + f sum_k G_k(f) F(f + k f_s),     Q = f Z

exactly. J holds what the motion before the first and after the last sample does, the record's own
leakage; G_k what the force does at images of f, for the law samples at f_s. However sharply the
velocity rises in a resonance, Z is smooth there, and Q of mass, damper and spring a polynomial of
second order. So about each frequency Q and J are parabolas and G_k constants, by least squares over

    3 / (M T), 5.9 Hz for the paper's window

where Q varies by chance as much as what the window gives, and with its degrees of freedom:
Var = s^2 [(A^H A)^-1]. What is left of the force, s^2, is what the perturbation does not explain at
the resolution of the record: nothing for a resonance, however narrow; most of it for a limit cycle,
whose power is in V and not in Q V. (Local polynomials: Pintelon, Schoukens, Vandersteen and Barbe
2010, "Estimation of nonparametric noise and FRF models for multivariable systems", MSSP 24.)

A parabola is not Q: the filters and the delay of the law bend it by more, most where the fit ends
with the record's frequencies, and a light part that resonates by itself bends it within the fit's
width. The fit is therefore made once more over half of the width, where the error is an eighth at
the ends of a parabola and less between them. What the two differ by, times `BIAS`, is part of the
interval.

What would break it: noise in the velocity, which shrinks |Z| as with "spa", and a drift of it, at
the lowest frequencies; features of Z itself that are narrower than half of the width by far.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Complexes, Flags, Floats, Integers
from hapticd.signal.covariances import same_length
from hapticd.signal.findings import LINE_WIDTH, leakage_findings, line_of
from hapticd.signal.impedance import Estimator, impedance
from hapticd.signal.kernels import TERMS, TINY, Fit, Transforms, kernels
from hapticd.signal.spectra import Spectra

__all__ = ["resolved"]

WIDTH = 3.0  # times 1/(M T): a parabola through the middle then has the variance of the window
NARROWER = 0.5  # times the width, of the fit that tells the bias
BIAS = 2.0  # times the difference of the two: 8/7 where Q is smooth, more where it bends within it
ABOUT = 3 * LINE_WIDTH  # lines on each side of one that is not explained


@dataclass(frozen=True, eq=False)
class Resolved(Spectra):
    """Spectra of a window in which lines, and the ends of a band, were replaced.

    Their ratio is Z by local polynomials, and their coherence gives its interval. Elsewhere they
    are the window's.
    """

    from_hz: float = 0.0  # first frequency that was replaced
    to_hz: float = 0.0  # last frequency that was replaced
    explained: float = 0.0  # share of the velocity's power there that the perturbation explains
    # (F,) of Z, relative: what the fit may be wrong by; 0 where nothing was replaced
    bias: Complexes = field(default_factory=lambda: np.zeros(0, np.complex128))

    def part(self, which: Flags | Integers | slice) -> Spectra:
        """Spectra at some of the frequencies, `which` (F,)."""
        return Spectra.part(replace(self, bias=self.bias[which]), which)

    @property
    def whole(self) -> bool:
        """Always false: what was replaced is no sum of covariances inside the window."""
        return False

    @property
    def resolved(self) -> bool:
        """Always true."""
        return True

    @property
    def ring(self) -> tuple[float, float]:
        """Time [s] in which the strongest motion falls by e once it is left alone, and its
        frequency [Hz]: the slope of Im Z over Re Z there; inf where Re Z does not damp it.
        """
        inside = (self.frequency_hz >= self.from_hz) & (self.frequency_hz <= self.to_hz)
        f = self.frequency_hz[inside]
        z = impedance(self.part(inside)).impedance_ns_per_m
        at = int(np.clip(np.argmax(self.velocity[inside]), 1, f.size - 2))
        slope_kg = (z[at + 1] - z[at - 1]).imag / (2.0 * np.pi * (f[at + 1] - f[at - 1]))
        return (float(slope_kg / z[at].real) if z[at].real > 0.0 else np.inf), float(f[at])

    @property
    def said(self) -> str:
        """How Z was found, in words."""
        step_hz = self.rate_hz / self.n_samples
        width_hz = WIDTH * self.rate_hz / self.lag
        return (
            f"motion narrower than the window of {self.lag} samples: judged again by the record's "
            f"own frequencies, {step_hz:.2g} Hz apart, by local polynomials {width_hz:.2g} Hz wide "
            f"from {self.from_hz:.3g} to {self.to_hz:.3g} Hz"
        )


def unresolved(
    trial: Spectra,
    band_hz: tuple[float, float],
    estimator: Estimator = "spa",
    linear: bool = False,
) -> Flags:
    """Which lines (F,) of a window's spectra need their record; none where the window is enough.

    These are all of a band that leaks or has a line that is not explained, and those about that
    line. What a `linear` device leaves unexplained is due to the window and to the record's ends,
    so there the record is needed in any case.
    """
    line = None if trial.resolved else line_of(trial)
    if trial.resolved or not (linear or line or leakage_findings(trial, band_hz, estimator)):
        return np.zeros(trial.frequency_hz.size, np.bool_)
    low_hz = max(trial.lowest_hz, band_hz[0] - trial.bandwidth_hz)  # read together with the edge
    needed = (trial.frequency_hz >= low_hz) & (trial.frequency_hz <= band_hz[1])
    if line is not None:
        needed[max(1, line.place - ABOUT) : line.place + ABOUT] = True
    return needed


def resolved(
    force_n: npt.ArrayLike,
    velocity_m_per_s: npt.ArrayLike,
    trial: Spectra,
    needed: Flags,
    band_hz: tuple[float, float],
    servo_rate_hz: float | None = None,
    transform_n: Complexes | None = None,
) -> Spectra:
    """Resolve the lines `needed` (F,) and the edges of the band in `trial`, the spectra of that
    record (N,); `trial` itself where none is needed.

    `servo_rate_hz` is the rate at which the law samples, if known; `transform_n` (N/2 + 1,) the
    `rfft` of the force, where it is known from another trial. AnalysisError for unequal lengths.
    """
    if not needed.any():
        return trial
    force = np.asarray(force_n, np.float64)
    velocity = np.asarray(velocity_m_per_s, np.float64)
    same_length(force, velocity)
    again = np.union1d(trial.frequency_hz[needed], band_hz)
    known = np.fft.rfft(force) if transform_n is None else transform_n
    transforms = known, np.fft.rfft(velocity)
    fit, narrower = (
        _fits(transforms, velocity.size, trial, again, servo_rate_hz, width)
        for width in (WIDTH, NARROWER * WIDTH)
    )
    differ = BIAS * (narrower.z - fit.z)
    bias = np.divide(differ, fit.z, out=np.zeros_like(differ), where=fit.z != 0.0)
    return _replaced(trial, again, fit, bias)


def _replaced(trial: Spectra, frequency_hz: Floats, fit: Fit, bias: Complexes) -> Resolved:
    """Return `trial` with what was fitted at `frequency_hz` (F,) in the place of its own lines
    there, and its relative `bias` (F,).
    """
    size = np.maximum(np.abs(fit.z) ** 2, TINY)
    share = 0.5 * trial.degrees_of_freedom * fit.variance / size
    explained = np.maximum(1.0 - fit.ends, 0.0) / (1.0 + share)
    rest = trial.part(~np.isin(trial.frequency_hz, frequency_hz))
    joined = np.concatenate((rest.frequency_hz, frequency_hz))
    order = np.argsort(joined)
    force = fit.power * size * (1.0 + share)
    return Resolved(
        frequency_hz=joined[order],
        velocity=np.concatenate((rest.velocity, fit.power))[order],
        force=np.concatenate((rest.force, force))[order],
        cross=np.concatenate((rest.cross, fit.z * fit.power))[order],
        rate_hz=trial.rate_hz,
        n_samples=trial.n_samples,
        lag=trial.lag,
        port=trial.port,
        from_hz=float(frequency_hz[0]),
        to_hz=float(frequency_hz[-1]),
        explained=float(fit.power @ explained / max(fit.power.sum(), TINY)),
        bias=np.concatenate((np.zeros(rest.frequency_hz.size, np.complex128), bias))[order],
    )


def _fits(
    transforms: tuple[Complexes, Complexes],
    samples: int,
    trial: Spectra,
    frequency_hz: Floats,
    servo_rate_hz: float | None,
    width: float,
) -> Fit:
    """Fits over `width` / (M T) to the `transforms` of force and velocity, at `frequency_hz`."""
    bins_per_hz = samples / trial.rate_hz
    half = max(2 * TERMS, round(0.5 * width * samples / trial.lag))
    servo = 0 if servo_rate_hz is None else round(servo_rate_hz * bins_per_hz)
    shifts = np.arange(servo, samples - 1, servo) if servo else np.empty(0, np.int64)
    whole = Transforms(*transforms, samples, half, shifts)
    places = np.clip(np.rint(frequency_hz * bins_per_hz).astype(np.int64), 1, samples // 2)
    fit = Fit.empty(places.size)
    kernels().local_fits(whole, places, fit)
    fit.power[:] /= samples
    return fit
