"""Z where the motion is narrower than the window: local polynomials on the record's frequencies.

The window averages a resonance of a fraction of a hertz with its surroundings and leaks it over the
whole band. The explained motion then looks unexplained, |Z| reads low and the phase is pulled
towards 0. The whole record resolves 1/(N T), 0.011 Hz for 90 s. With its transforms F of the force
and V of the velocity, a linear device obeys

    f F(f) = Q(f) V(f) + J(f) + f sum_k G_k(f) F(f + k f_s),     Q = f Z

exactly. J is the effect of the motion before the first and after the last sample, the record's own
leakage. G_k is the effect of the force at images of f, because the law samples at f_s. However
sharply the velocity rises in a resonance, Z is smooth there, and Q of mass, damper and spring is a
polynomial of second order. So about each frequency Q and J are parabolas and G_k constants, fitted
by least squares over

    3 / (M T), 5.9 Hz for the paper's window

where the random error of Q equals that of the window, with its degrees of freedom: Var = s^2 [(A^H
A)^-1]. The residual s^2 of the force is the part that the perturbation does not explain at the
resolution of the record. It is zero for a resonance, however narrow. It is most of the force for a
limit cycle, whose power is in V and not in Q V. (Local polynomials: Pintelon, Schoukens,
Vandersteen and Barbe 2010, "Estimation of nonparametric noise and FRF models for multivariable
systems", MSSP 24.)

Q is not exactly a parabola. The filters and the delay of the law bend it further, most at the ends
of the record's frequencies, and a light part with a resonance of its own bends it within the width
of the fit. The fit is therefore repeated over half of the width, where the error is an eighth at
the ends of a parabola and less between them. The difference of the two, times `BIAS`, is part of
the interval.

Lines at low frequencies. A window of M samples reveals a line by comparison with its neighbours.
Its first twelve frequencies, 2 to 11.7 Hz for the paper's, have too few. There the whole record,
which resolves 1/(N T), separates a limit cycle or hum from a resonance:

    f F(f) = Q(f) V(f) + J(f) + E(f),     Q = f Z

as above, except that Q and J are polynomials over all of these frequencies. Q of mass, damper and
spring is of second order, however sharply the velocity rises in their resonance. E is the
unexplained force, and E / Q the unexplained velocity: zero in a resonance, a narrow line in a limit
cycle, broad with friction or noise.

Least squares would fit Q to the line, which is in V: a strong one draws Q to 0 and hides itself.
The equations are therefore not weighted with V but with f F / Q of the previous round, the motion
due to the force alone, which excludes the line (instrumental variables; Young 1970, "An
instrumental variable method for real-time identification of a noisy process", Automatica 6).
Frequencies with a large E count less in the next round (Cauchy's weights).

A line is reported where it carries a fiftieth of the velocity's power and E exceeds the
neighbouring median, at one of three widths: 4 frequencies of the record, 16 and 64, or two thirds
of a hertz. Friction, noise and counts never came near either threshold (tests).

Limitations: noise in the velocity, which shrinks |Z| as with "spa", or its drift at the lowest
frequencies; features of Z much narrower than half of the width; a resonance of a light part below
12 Hz that a polynomial does not follow; a limit cycle that wanders over more than a hertz.
"""

from dataclasses import dataclass, field, replace
from math import log
from typing import ClassVar

import numpy as np
import numpy.typing as npt
from numpy.polynomial.legendre import legvander

from hapticd.core.arrays import Complexes, Flags, Floats, Integers
from hapticd.signal.covariances import TERMS, TINY, Fit, Transforms, detrended, kernels, same_length
from hapticd.signal.findings import (
    LINE_WIDTH,
    SMALL_LINE,
    Finding,
    leakage_findings,
    line_finding,
    line_of,
)
from hapticd.signal.impedance import Estimator, impedance
from hapticd.signal.spectra import Spectra

WIDTH = 3.0  # times 1/(M T): a parabola through the middle then has the variance of the window
NARROWER = 0.5  # times the width, of the fit that measures the bias
BIAS = 2.0  # times the difference of the two: 8/7 where Q is smooth, more where it bends within it
ABOUT = 3 * LINE_WIDTH  # lines on each side of an unexplained one


@dataclass(frozen=True, eq=False)
class Resolved(Spectra):
    """Spectra of a window in which lines, and the ends of a band, were replaced.

    At the replaced frequencies their ratio is Z by local polynomials, and their coherence gives its
    interval.
    """

    from_hz: float = 0.0  # first frequency that was replaced
    to_hz: float = 0.0  # last frequency that was replaced
    explained: float = 0.0  # share of the velocity's power there that the perturbation explains
    # (F,) of Z, relative: possible error of the fit; 0 where nothing was replaced
    bias: Complexes = field(default_factory=lambda: np.zeros(0, np.complex128))

    resolved: ClassVar[bool] = True

    def part(self, which: Flags | Integers | slice) -> Spectra:
        """Return spectra at some of the frequencies, `which` (F,)."""
        return Spectra.part(replace(self, bias=self.bias[which]), which)

    @property
    def whole(self) -> bool:
        """Always false: replaced lines are not a sum of covariances inside the window."""
        return False

    @property
    def ring(self) -> tuple[float, float]:
        """Time [s] in which the strongest motion decays by e when free, 2 m / Re Z, and the
        frequency [Hz] of the line next to it; inf where Re Z does not damp it.

        2 pi m is the slope of f Im Z over f^2. The velocity is a mean over the width of a fit, so
        all lines within half of that from the resonance have the same size. The resonance is where
        |Z| is smallest.
        """
        fitted = self.part((self.frequency_hz >= self.from_hz) & (self.frequency_hz <= self.to_hz))
        f = fitted.frequency_hz
        z = impedance(fitted).impedance_ns_per_m
        loud = fitted.velocity > 0.5 * fitted.velocity.max()
        at = int(np.clip(np.argmin(np.where(loud, np.abs(z), np.inf)), 1, f.size - 2))
        beside = [at - 1, at + 1]
        mass_kg = np.diff((f * z.imag)[beside]) / (2.0 * np.pi * np.diff(f[beside] ** 2))
        ring_s = 2.0 * mass_kg.item() / z[at].real if z[at].real > 0.0 else np.inf
        return float(ring_s), float(f[at])

    @property
    def said(self) -> str:
        """Description of the method that found Z."""
        width_hz = WIDTH * self.rate_hz / self.lag
        return (
            f"motion narrower than the window of {self.lag} samples: judged again by the record's "
            f"own frequencies, {1.0 / self.seconds:.2g} Hz apart, by local polynomials"
            f" {width_hz:.2g} Hz wide from {self.from_hz:.3g} to {self.to_hz:.3g} Hz"
        )


def unresolved(
    trial: Spectra,
    band_hz: tuple[float, float],
    estimator: Estimator = "spa",
    linear: bool = False,
) -> Flags:
    """Return which lines (F,) of a window's spectra need their record; none if the window is
    sufficient.

    If a band leaks or has an unexplained line, these are all of its lines and those about that
    line. For a `linear` device any unexplained motion is due to the window and to the record's
    ends, so the record is needed in any case.
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
    record (N,). Return `trial` itself if no line is needed.

    `servo_rate_hz` is the rate at which the law samples, if known; `transform_n` (N/2 + 1,) is the
    `rfft` of the force, if known from another trial. AnalysisError for unequal lengths.
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
    """Return `trial` with its lines at `frequency_hz` (F,) replaced by the fit, and the fit's
    relative `bias` (F,).
    """
    size = np.maximum(np.abs(fit.z) ** 2, TINY)
    share = 0.5 * trial.degrees_of_freedom * fit.variance / size
    explained = np.maximum(1.0 - fit.ends, 0.0) / (1.0 + share)
    rest = trial.part(~np.isin(trial.frequency_hz, frequency_hz))
    joined = np.concatenate((rest.frequency_hz, frequency_hz))
    order = np.argsort(joined)
    return Resolved(
        frequency_hz=joined[order],
        velocity=np.concatenate((rest.velocity, fit.power))[order],
        force=np.concatenate((rest.force, fit.power * size * (1.0 + share)))[order],
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
    """Fit over `width` / (M T) to the `transforms` of force and velocity, at `frequency_hz`."""
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


# --- lines below those of the window --------------------------------------------------------------


FIRST_SHOWN = 2 * LINE_WIDTH  # of the window's own lines at which it shows unexplained power
HINT = 2.0  # of a line over those beyond the window's width
ORDER = 4  # of both polynomials; the device's own is of the second
ROUNDS = 6
RIDGE = 1e-12
WIDTHS = (4, 16, 64)  # frequencies of the record: a sine between two of them, and wandering ones
WIDEST = 1.0 / 3.0  # of 1/(M T)
REACH = 0.75  # of 1/(M T): range about a line over which E is compared
HEIGHT = 6.0  # of a line over that; four values of noise reach it once in 10^7
STRIDE = 16  # frequencies between medians
WEIGHT = 4.0  # times the usual |E|^2, at which a frequency counts half


@dataclass(frozen=True, eq=False)
class LowFit:
    """The fit at F frequencies of a record."""

    frequency_hz: Floats  # (F,)
    rest: Floats  # (F,) |E|^2
    unexplained: Floats  # (F,) |E / Q|^2 over the velocity's power


def hinted(trial: Spectra) -> bool:
    """Whether a window's spectra suggest a line among their first frequencies: unexplained power at
    least that of its neighbours, which falls within the window's width. The record then decides.
    """
    if not trial.whole or trial.frequency_hz.size <= 2 * FIRST_SHOWN:
        return False
    lines = trial.part(slice(FIRST_SHOWN + 4))
    near = lines.velocity * (1.0 - lines.coherence)
    some = np.arange(2, FIRST_SHOWN + 1)
    close = near[some - 1] + near[some] + near[some + 1]
    least = np.minimum(near[some - 1], near[some + 1])
    falls = (near[some] >= least) & (near[some] > HINT * near[some + 3])
    return bool((falls & (close > SMALL_LINE * trial.velocity.sum())).any())


def low_line(
    force_n: npt.ArrayLike, velocity_m_per_s: npt.ArrayLike, trial: Spectra
) -> tuple[Finding, ...]:
    """Report the strongest line of a record (N,) between the lowest frequency of the window of
    `trial`, its spectra, and the first at which the window shows lines. Empty unless `hinted`.
    AnalysisError for unequal lengths.
    """
    if not hinted(trial):
        return ()
    force = np.asarray(force_n, np.float64)
    velocity = np.asarray(velocity_m_per_s, np.float64)
    same_length(force, velocity)
    found = _fitted(force, velocity, trial)
    widest = int(WIDEST * trial.lowest_hz * trial.seconds)
    widths = {min(width, widest) for width in WIDTHS if widest >= WIDTHS[0]}
    lines = [_strongest(found, trial, width) for width in sorted(widths)]
    share, frequency_hz = max(lines, default=(0.0, 0.0))
    return (line_finding(frequency_hz, min(share, 1.0)),) if share > SMALL_LINE else ()


def _fitted(force_n: Floats, velocity_m_per_s: Floats, trial: Spectra) -> LowFit:
    """Fit from half the window's lowest frequency to a little above its first shown line."""
    low = 0.5 * trial.lowest_hz
    high = (0.5 * FIRST_SHOWN + 1.0) * trial.lowest_hz
    bins = np.arange(int(np.ceil(low * trial.seconds)), int(high * trial.seconds) + 1)
    f = bins / trial.seconds
    force = np.fft.rfft(force_n)[bins]
    moved = np.fft.rfft(detrended(velocity_m_per_s))
    whole = float(np.vdot(moved[1:], moved[1:]).real)
    powers = legvander((2.0 * f - low - high) / (high - low), ORDER).astype(np.float64)
    rest, slope = _explained(f * force, force, moved[bins], powers)
    return LowFit(f, rest, rest / np.maximum(np.abs(slope) ** 2 * whole, TINY))


def _explained(
    wanted: Complexes, force: Complexes, velocity: Complexes, powers: Floats
) -> tuple[Floats, Complexes]:
    """Return |E|^2 and Q (F,) of `wanted` = Q `velocity` + J + E, polynomials in `powers` (F,
    p).
    """
    columns = _columns(velocity, powers)
    instrument = force
    weights = np.ones(wanted.size)
    for _ in range(ROUNDS):
        taken = _columns(instrument, powers).conj() * weights[:, None]
        normal = np.einsum("fc,fd->cd", taken, columns) + RIDGE * np.eye(columns.shape[1])
        found = np.linalg.solve(normal, np.einsum("fc,f->c", taken, wanted))
        rest = np.abs(wanted - np.einsum("fc,c->f", columns, found)) ** 2
        slope = np.einsum("fp,p->f", powers, found[: powers.shape[1]]) / _size(velocity)
        instrument = wanted / np.where(slope == 0.0, TINY, slope)
        weights = 1.0 / (1.0 + rest / max(WEIGHT * _mean(rest), TINY))
    return rest, slope


def _columns(moved: Complexes, powers: Floats) -> Complexes:
    """Return the columns of Q and of J, (F, 2 p), each of mean size 1."""
    return np.concatenate((powers * (moved / _size(moved))[:, None], powers + 0j), axis=1)


def _size(values: Complexes) -> float:
    return max(float(np.sqrt(np.mean(np.abs(values) ** 2))), float(TINY))


def _mean(power: Floats) -> float:
    """Return the mean of an exponentially distributed power with a few lines, from its median."""
    return float(np.median(power)) / log(2.0)


def _strongest(found: LowFit, trial: Spectra, width: int) -> tuple[float, float]:
    """Return the share of the velocity's power and the frequency [Hz] of the strongest line that
    exceeds its surroundings.
    """
    f = found.frequency_hz
    rest, share = (
        np.convolve(one, np.ones(width), "same") for one in (found.rest, found.unexplained)
    )
    reach = max(1, int(REACH * trial.lowest_hz / (f[1] - f[0])))
    starts = range(0, f.size, STRIDE)
    usual = [_mean(found.rest[max(0, at - reach) : at + reach + 1]) for at in starts]
    stands_out = rest > HEIGHT * width * np.repeat(usual, STRIDE)[: f.size]
    last_hz = 0.5 * FIRST_SHOWN * trial.lowest_hz
    share[~stands_out | (f < trial.lowest_hz) | (f > last_hz)] = 0.0
    best = int(np.argmax(share))
    about = slice(max(0, best - width // 2), best + width // 2 + 1)
    centre_hz = float(np.average(f[about], weights=found.unexplained[about] + TINY))
    return float(share[best]), centre_hz
