"""From the spectra of a record to its verdict, in one function.

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
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Complexes, Flags, Floats, lazy_property
from hapticd.signal.channels import unit_findings
from hapticd.signal.findings import Finding, Record, examine, leakage_findings
from hapticd.signal.impedance import Estimator, Impedance, impedance
from hapticd.signal.periodic import PeriodicSpectra, periodic_findings
from hapticd.signal.resolved import hinted, low_line, resolved, unresolved
from hapticd.signal.spectra import Spectra, corrected
from hapticd.signal.verdict import DEFAULT_BAND_HZ, Verdict, judge

__all__ = ["Assessment", "Criteria", "LoopModel", "MeasuredTrial", "assess"]


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
