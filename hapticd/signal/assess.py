"""From the spectra of a record to its verdict, in one function.

    spectra      of a window (`spectra`) or of whole periods (`periodic`); known faults of the
                 velocity channel are taken out (`corrected`)
    findings     of the samples and of the spectra (`findings`, `channels`), and those of the source
    verdict      at the resolution of the window (`verdict`)
    resolution   where the window does not resolve what decides, the record does (`resolved`); so it
                 does for lines below those that the window shows (`resolved`). Then the verdict is
                 found again
    impedance    Z with its uncertainty, at the port that was asked for (`impedance`)

The samples of one trial are there. A batch keeps none: it assesses the spectra of all trials,
simulates those again that `needs_record` names, and gives their samples to `with_samples`. A trial
that is still under way has its spectra alone: its verdict is final where `needed` is empty.

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
    """The band that is judged, and how; see `judge`. `skew_s`, `high_pass_hz`: known faults of the
    velocity channel that are taken out (`corrected`).
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
    """What a model says of the loop: spectral radius, whether the device has no friction, and the
    rate at which the law samples [Hz]; None where it is not known.
    """

    spectral_radius: float | None = None
    linear: bool = False
    servo_rate_hz: float | None = None


@dataclass(frozen=True, eq=False)
class MeasuredTrial:
    """The spectra of a trial as recorded, with its samples or with what is known of them.

    `samples`: force [N] and velocity [m/s] (N,). `record`: of a trial that kept no samples.
    `findings`: those of the source. A `simulated` record has no faults of its channels.
    """

    spectra: Spectra
    samples: tuple[Floats, Floats] | None = None
    record: Record | None = None
    findings: tuple[Finding, ...] = ()
    simulated: bool = True


@dataclass(frozen=True, eq=False)
class Assessment:
    """A verdict with the `spectra` that it was found by, at the port of the probe."""

    trial: MeasuredTrial
    criteria: Criteria
    model: LoopModel
    spectra: Spectra
    verdict: Verdict

    @lazy_property
    def needed(self) -> Flags:
        """Lines (F,) of the window that the record must resolve before the verdict stands.

        The verdict stands where all is passive at the resolution of the window. A line of which the
        perturbation explains nothing there may be a resonance that rings for many windows.
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
        """Z with its uncertainty, behind the mass of the probe where that was asked for."""
        z = impedance(self.spectra, self.criteria.estimator)
        mass_kg = self.criteria.behind_mass_kg
        return z.without_mass(mass_kg) if mass_kg else z

    def with_samples(
        self,
        force_n: npt.ArrayLike,
        velocity_m_per_s: npt.ArrayLike,
        transform_n: Complexes | None = None,
    ) -> "Assessment":
        """The assessment by the record (N,) as well; itself where that changes nothing.

        `transform_n` (N/2 + 1,): the `rfft` of the force, where it is known from another trial.
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
    """Assess a trial by its spectra, and by its samples where it has them. AnalysisError as `judge`
    and `examine`.
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
    """What the samples say, with the findings of the source and those of the spectra."""
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
