"""From the spectra of a record to its verdict, and Z from a periodic force.

Assessment (`assess`). One function takes all steps:

    spectra      of a window (`spectra`) or of whole periods (`periodic`), corrected for known
                 faults of the velocity channel (`corrected`)
    findings     of the samples and of the spectra (`findings`, `channels`), and those of the source
    verdict      at the resolution of the window (`verdict`)
    resolution   if the window does not resolve the decisive lines, or lines below its lowest
                 frequency, the whole record does (`resolved`), and the verdict is repeated
    impedance    Z with its uncertainty, at the requested port (`impedance`)

A single trial has its samples. A batch keeps none: it assesses the spectra of all trials, simulates
those that report `needs_record` again, and passes their samples to `with_samples`. A trial that is
still running has only its spectra; its verdict is final if `needed` is empty.

Spectra must be those of the samples.

Periodic force (`periodic`). It needs no window and does not leak; its interval holds with friction
too. Over a whole period of a settled motion the discrete Fourier transform separates every
harmonic. With R realisations of the force (the same amplitudes, other random phases) and F_m, V_m
their means over the periods:

    Y    = <V_m F_m*> / <|F_m|^2>                  means over the realisations: the best linear
                                                   approximation of 1/Z
    s^2  = sum |V_m / F_m - Y|^2 / (R - 1)         scatter of one realisation: noise, and nonlinear
                                                   distortion
    s^2 / R                                        variance of Y; exactly Student's t with 2 (R - 1)
                                                   degrees of freedom

(Pintelon and Schoukens, System Identification, 2nd ed. 2012, sections 3.4 and 4.3.) Distortion by
the device repeats with the period. Averaging periods removes noise but not distortion, and the
scatter between periods does not show it. Only other phases do, so the interval of one realisation
covers noise alone and decides nothing. The mean spectra of several realisations have the form of
`spectra.Spectra`, so `judge` accepts them. Their coherence is 1 / (1 + (R - 1) s^2 / (R |Y|^2)).

Limitations: a motion that has not settled; lost samples (refused, because the force does not
repeat); a single realisation.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Complexes, Flags, Floats, Integers, lazy_property
from hapticd.core.errors import AnalysisError
from hapticd.core.units import DEFAULT_BAND_HZ, percent
from hapticd.signal.channels import unit_findings
from hapticd.signal.findings import Finding, Record, examine, leakage_findings
from hapticd.signal.impedance import Estimator, Impedance, impedance
from hapticd.signal.resolved import hinted, low_line, resolved, unresolved
from hapticd.signal.spectra import Spectra, corrected, grid_frequencies
from hapticd.signal.verdict import Verdict, judge

__all__ = [
    "CHANGING",
    "Assessment",
    "Criteria",
    "LoopModel",
    "MeasuredTrial",
    "PeriodicSpectra",
    "assess",
    "changing",
    "periodic",
]

# --- periodic force -------------------------------------------------------------------------------
LEAST_POWER = 1e-9  # of the strongest harmonic's power: below it a harmonic is not excited
CHANGING = (
    0.03  # of the force's rms, part that may not repeat: resolution and noise of the torque channel
)
DISTORTED = 0.01  # scatter between realisations from which distortion is reported
UNKNOWN: Floats = np.empty(0)


@dataclass(frozen=True, eq=False)
class PeriodicSpectra(Spectra):
    """Mean spectra over realisations on the harmonics k rate / period, k = 0..period/2; zero power
    at harmonics without excitation.
    """

    realisations: int = 1  # of the force: other phases, same amplitudes
    periods: int = 1  # of each realisation
    # (F,) standard deviation of V/F over its mean; nan for one period
    between_periods: Floats = field(default_factory=lambda: UNKNOWN)
    # (F,) the same between realisations; nan for one
    between_realisations: Floats = field(default_factory=lambda: UNKNOWN)

    exact: ClassVar[bool] = True
    resolved: ClassVar[bool] = True

    def part(self, which: Flags | Integers | slice) -> "PeriodicSpectra":
        """Return spectra at some of the harmonics, `which` (F,)."""
        found = super().part(which)
        assert isinstance(found, PeriodicSpectra)
        between = (self.between_periods[which], self.between_realisations[which])
        return replace(found, between_periods=between[0], between_realisations=between[1])

    @property
    def variance_factor(self) -> float:
        """Relative variance of a mean: one over the number of averages."""
        return 1.0 / (self.realisations if self.realisations > 1 else self.periods)

    @property
    def bandwidth_hz(self) -> float:
        """One over the period, the spacing of the harmonics."""
        return 0.5 * self.rate_hz / self.lag

    @property
    def lowest_hz(self) -> float:
        """One over the period."""
        return self.bandwidth_hz

    @property
    def smoothing_hz2(self) -> float:
        """Zero: there is no smoothing."""
        return 0.0

    @property
    def span(self) -> str:
        """Description of the interval of analysis."""
        return f"period of {2 * self.lag} samples"

    @property
    def covers(self) -> str:
        """Description of the errors that the intervals cover."""
        if self.realisations > 1:
            return (
                "noise and nonlinear distortion at this perturbation, from the scatter of"
                f" {self.realisations} realisations of {self.periods} periods"
            )
        return (
            f"noise alone, from the scatter of {self.periods} periods; nonlinear distortion such as"
            " friction's is not covered"
        )

    def scatter(self, band_hz: tuple[float, float]) -> tuple[float, float]:
        """Return medians over a band of the relative scatter between periods and between
        realisations; nan where unknown.
        """
        inside = (self.frequency_hz >= band_hz[0]) & (self.frequency_hz <= band_hz[1])
        return float(np.median(self.between_periods[inside])), float(
            np.median(self.between_realisations[inside])
        )


def periodic(
    force_n: npt.ArrayLike, velocity_m_per_s: npt.ArrayLike, rate_hz: float
) -> PeriodicSpectra:
    """Return mean spectra of settled periods, force and velocity (realisations, periods, samples)
    float64.

    AnalysisError for other shapes, odd periods, values that are not finite, or a force that does
    not repeat.
    """
    force, velocity = (np.asarray(signal, np.float64) for signal in (force_n, velocity_m_per_s))
    _check_periods(force, velocity)
    f, v = (_harmonics(signal) for signal in (force, velocity))
    if (share := changing(force)) > CHANGING:
        raise AnalysisError(
            f"the force does not repeat from period to period ({percent(share)} of it changes):"
            " samples were lost, or it is not a multisine of that period; record it again"
        )
    return _spectra(f, v, rate_hz, force.shape[2])


def _check_periods(force: Floats, velocity: Floats) -> None:
    """Raise AnalysisError unless both are whole even periods of finite values."""
    if force.ndim != 3 or force.shape != velocity.shape or not force.size or force.shape[2] % 2:
        raise AnalysisError(
            f"force {force.shape} and velocity {velocity.shape}: both must be (realisations,"
            " periods, samples), samples even"
        )
    if not (np.isfinite(force).all() and np.isfinite(velocity).all()):
        raise AnalysisError(
            "the record holds values that are not finite; drop or repair them before the analysis"
        )


def _spectra(f: Complexes, v: Complexes, rate_hz: float, samples: int) -> PeriodicSpectra:
    """Means over the harmonics of the force `f` and of the velocity `v`, (realisations, periods,
    samples/2 + 1) each.
    """
    realisations, periods, _ = f.shape
    power = _power(f).mean(axis=(0, 1))
    v[..., power < LEAST_POWER * power.max()] = 0.0
    between_periods = np.sqrt(np.mean(_scatter(v, axis=1), axis=0))
    between_realisations = np.sqrt(_scatter(v.mean(axis=1) * f.mean(axis=1).conj(), axis=0))
    if realisations > 1:  # noise between periods is no longer of interest
        f = f.mean(axis=1)[:, None]
        v = v.mean(axis=1)[:, None]
    return PeriodicSpectra(
        frequency_hz=grid_frequencies(rate_hz, samples // 2),
        velocity=_power(v).mean(axis=(0, 1)) / samples,
        force=_power(f).mean(axis=(0, 1)) / samples,
        cross=(f * v.conj()).mean(axis=(0, 1)) / samples,
        rate_hz=rate_hz,
        n_samples=realisations * periods * samples,
        lag=samples // 2,
        realisations=realisations,
        periods=periods,
        between_periods=between_periods,
        between_realisations=between_realisations,
    )


def periodic_findings(trial: PeriodicSpectra, band_hz: tuple[float, float]) -> Iterator[Finding]:
    """Report a single realisation, which decides nothing, and distortion above a hundredth with its
    remedy.
    """
    if trial.realisations == 1:
        yield Finding(
            "one_realisation",
            "one realisation: the interval covers noise alone, and nothing tells distortion from"
            " the device; ask for several realisations",
            voids=True,
        )
        return
    noise, total = trial.scatter(band_hz)
    if total > DISTORTED and trial.periods == 1:
        yield Finding(
            "scatter",
            f"noise or nonlinear distortion: realisations scatter by {percent(total)}; more of"
            " them make the interval shorter, and two periods of each would tell which it is",
        )
    elif total > DISTORTED and total > 2.0 * noise:
        yield Finding(
            "distortion",
            f"nonlinear distortion: realisations scatter by {percent(total)}, periods of one by"
            f" {percent(noise)}; more realisations make the interval shorter, more periods do not",
        )


def _harmonics(signal: Floats) -> Complexes:
    found = np.fft.rfft(signal, axis=2)
    found[..., 0] = 0.0
    return np.asarray(found)


def _power(harmonics: Complexes) -> Floats:
    return np.asarray(harmonics.real**2 + harmonics.imag**2)


def _scatter(values: Complexes, axis: int) -> Floats:
    """Return the variance along `axis` over the square of the mean; nan for a single value or a
    mean of 0.
    """
    count = values.shape[axis]
    mean = values.mean(axis=axis, keepdims=True)
    variance = _power(values - mean).sum(axis=axis) / max(1, count - 1)
    square = _power(mean).sum(axis=axis)
    known = (square > 0.0) & (count > 1)
    return np.asarray(np.divide(variance, square, out=np.full_like(variance, np.nan), where=known))


def changing(force_n: Floats) -> float:
    """Return the rms of the part of a force (realisations, periods, samples) that does not repeat
    over that of the part that does; inf for zero force.
    """
    force = _harmonics(force_n)
    mean = force.mean(axis=1, keepdims=True)
    changes = float(_power(force - mean).sum())
    stays = float(_power(mean).sum()) * force.shape[1]
    return float(np.sqrt(changes / stays)) if stays > 0.0 else np.inf


# --- assessment -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Criteria:
    """The judged band and the criteria; see `judge`. `skew_s` and `high_pass_hz` are known faults
    of the velocity channel, which are removed (`corrected`).
    """

    band_hz: tuple[float, float] = DEFAULT_BAND_HZ
    confidence: float = 0.95
    estimator: Estimator = "spa"
    behind_mass_kg: float = 0.0
    skew_s: float = 0.0
    high_pass_hz: float = 0.0
    below_window: bool = False


@dataclass(frozen=True, slots=True)
class LoopModel:
    """Properties of the loop from a model: spectral radius, whether the device is free of friction,
    and the sample rate of the law [Hz]. None: not known.
    """

    spectral_radius: float | None = None
    linear: bool = False
    servo_rate_hz: float | None = None


@dataclass(frozen=True, eq=False)
class MeasuredTrial:
    """The spectra of a trial as recorded, with its samples or a summary of them.

    `samples`: force [N] and velocity [m/s] (N,). `record`: summary for a trial that kept no
    samples. `findings`: those of the source. The channels of a `simulated` record have no faults.
    """

    spectra: Spectra
    samples: tuple[Floats, Floats] | None = None
    record: Record | None = None
    findings: tuple[Finding, ...] = ()
    simulated: bool = True


@dataclass(frozen=True, eq=False)
class Assessment:
    """A verdict, and the `spectra` at the port of the probe from which it was made."""

    trial: MeasuredTrial
    criteria: Criteria
    model: LoopModel
    spectra: Spectra
    verdict: Verdict

    @lazy_property
    def needed(self) -> Flags:
        """Lines (F,) of the window that the record must resolve before the verdict is final.

        The verdict is final if every line is passive at the resolution of the window. A line there
        with no coherence may be a resonance that rings for many windows.
        """
        window = self.trial.spectra
        swells = any(one.code == "swells" for one in self.verdict.findings)
        if self.verdict.answer == "passive" and not swells:
            return np.zeros(window.frequency_hz.size, np.bool_)
        criteria = self.criteria
        linear = self.model.linear or swells
        return unresolved(window, criteria.band_hz, criteria.estimator, linear)

    @property
    def needs_record(self) -> bool:
        """Whether the samples may change the verdict."""
        return bool(self.needed.any()) or hinted(self.trial.spectra)

    @property
    def impedance(self) -> Impedance:
        """Z with its uncertainty, behind the mass of the probe if requested."""
        z = impedance(self.spectra, self.criteria.estimator)
        mass_kg = self.criteria.behind_mass_kg
        return z.without_mass(mass_kg) if mass_kg else z

    def with_samples(
        self,
        force_n: npt.ArrayLike,
        velocity_m_per_s: npt.ArrayLike,
        transform_n: Complexes | None = None,
    ) -> "Assessment":
        """Return the assessment refined with the record (N,), or itself if nothing changes.

        `transform_n` (N/2 + 1,): the `rfft` of the force, if known from another trial.
        AnalysisError for unequal lengths.
        """
        window = self.trial.spectra
        low = low_line(force_n, velocity_m_per_s, window)
        if not (self.needed.any() or low):
            return self
        finer = resolved(
            force_n,
            velocity_m_per_s,
            window,
            self.needed,
            self.criteria.band_hz,
            self.model.servo_rate_hz,
            transform_n,
        )
        record = self.trial.record
        record = record and replace(record, findings=(*record.findings, *low))
        return _judged(replace(self.trial, record=record), self.criteria, self.model, finer)


def assess(trial: MeasuredTrial, criteria: Criteria, model: LoopModel) -> Assessment:
    """Assess a trial from its spectra, and from its samples if it has them. AnalysisError as for
    `judge` and `examine`.
    """
    if trial.samples is None:
        return _judged(trial, criteria, model, trial.spectra)
    record = _examined(trial, criteria, *trial.samples)
    first = _judged(replace(trial, record=record), criteria, model, trial.spectra)
    return first.with_samples(*trial.samples)


def _judged(trial: MeasuredTrial, criteria: Criteria, model: LoopModel, raw: Spectra) -> Assessment:
    spectra = corrected(raw, criteria.skew_s, criteria.high_pass_hz)
    verdict = judge(
        spectra,
        trial.record,
        criteria.band_hz,
        criteria.confidence,
        criteria.estimator,
        model.spectral_radius,
        criteria.behind_mass_kg,
        not trial.simulated,
        criteria.below_window,
    )
    return Assessment(trial, criteria, model, spectra, verdict)


def _examined(
    trial: MeasuredTrial, criteria: Criteria, force_n: Floats, velocity_m_per_s: Floats
) -> Record:
    """Summarise the samples, with the findings of the source and of the spectra."""
    spectra = corrected(trial.spectra, criteria.skew_s, criteria.high_pass_hz)
    record = examine(force_n, velocity_m_per_s, spectra.rate_hz)
    findings = [*record.findings, *trial.findings]
    if isinstance(spectra, PeriodicSpectra):
        findings += periodic_findings(spectra, criteria.band_hz)
    else:
        findings += leakage_findings(spectra, criteria.band_hz, criteria.estimator)
    if not trial.simulated:
        findings += unit_findings(spectra, float(force_n.std()), record.velocity_sd_m_per_s)
    return replace(record, findings=tuple(findings))
