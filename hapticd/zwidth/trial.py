"""One trial of one environment: recorded under noise or multisines, judged, and stored with
everything that its numbers depend on.

Params -> plan_trial -> Plan -> run_trial -> Result. The plan contains the expectation: whether the
predicted loop is stable, and its impedance, if there is a model of the device. An environment that
is predicted to be unstable is tried all the same (the monitor ends the trial); the verdict is then
not passive, with the spectral radius.

A trial by multisines plays several realisations of a periodic force, each settled for one period
and measured for some. It has the period of the window's grid (4096 samples), every harmonic with
one amplitude, and new random phases for every realisation. Its density is that of the noise it
replaces, so friction acts alike. Its spectrum ends at the edge of the judged band: the loop is
sampled, and a perturbation above half of its rate is folded back into the band (1e-3 of Z at 1
kHz).

For a device without friction 2 s of it determine Z better than 90 s of noise. Friction distorts, in
the same way in every period. Only more realisations average the distortion and show its size
(`signal.assess`).

The record holds the realisations one after the other, each from rest and with its settling period.
A realisation whose force did not repeat, because a stalled host let the board run out of samples,
is recorded again.

Limitations: a loop so lightly damped that it rings for more than a period.

On disk it is a run folder with record, summary and Z(f):

run.json         verdict and everything that it depends on
impedance.csv    a line for each frequency of the estimate, with the units in the header line; empty
                 where not known
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import inf, isfinite, isnan, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from hapticd.core.arrays import Complexes
from hapticd.core.errors import AnalysisError
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.model.loop import spectral_radius
from hapticd.model.predict import coulomb, predicted_impedance
from hapticd.model.scene import Excitation, Scene
from hapticd.signal.assess import (
    CHANGING,
    Criteria,
    LoopModel,
    MeasuredTrial,
    PeriodicSpectra,
    assess,
    changing,
    periodic,
)
from hapticd.signal.findings import Finding
from hapticd.signal.impedance import Impedance
from hapticd.signal.spectra import DEFAULT_LAG, Spectra, spa
from hapticd.signal.verdict import LEAST_FREEDOM, Verdict
from hapticd.zwidth.recorded import read_file
from hapticd.zwidth.sources import Display, ReferenceSines, Source, Trial, display
from hapticd.zwidth.store import (
    IMPEDANCE,
    EndReason,
    Progress,
    Steps,
    TrialEnd,
    TrialRecord,
    csv_text,
    fingerprint,
    record_path,
    silent,
    too_short,
    write_run,
)
from hapticd.zwidth.watch import AT_LIMIT, limit_findings, loss_findings, summed

__all__ = [
    "SHORTEST_WINDOWS",
    "MultisineLayout",
    "TrialParams",
    "TrialPlan",
    "TrialResult",
    "judged",
    "kept_trial",
    "multisine_like",
    "plan_trial",
    "run_trial",
    "summary",
    "write",
]

PERIOD = 2 * DEFAULT_LAG  # samples
SPARE_S = 0.01  # periods need not be whole ticks
TRIES = 8  # of a realisation
SHORTEST_WINDOWS = LEAST_FREEDOM / 2 * 0.75


@dataclass(frozen=True, slots=True)
class MultisineLayout:
    """`realisations` of the force, each of one settling period and `periods` measured ones."""

    realisations: int = 8
    periods: int = 2

    @property
    def samples(self) -> int:
        """Samples of one realisation, with its settling period."""
        return (self.periods + 1) * PERIOD

    @property
    def seconds(self) -> float:
        """Seconds of all realisations."""
        return self.realisations * self.samples / PROBE_RATE_HZ


def multisine_like(noise: Excitation, highest_hz: float) -> Excitation:
    """Return the multisine of the density and seed of `noise`, up to `highest_hz`."""
    band_hz = min(noise.band_hz, highest_hz)
    force_n = sqrt(noise.psd_n2_per_hz * band_hz)
    return replace(
        noise, kind="multisine", band_hz=band_hz, force_n=force_n, period_s=PERIOD / PROBE_RATE_HZ
    )


def record_multisines(
    trial: Trial, layout: MultisineLayout, source: Source, tell: Progress = silent
) -> TrialRecord:
    """Record every realisation with `source`, until one ends early. AnalysisError if not even the
    first was complete, or if one never repeated; otherwise as the source.
    """
    steps = Steps(tell, layout.realisations)
    whole = []
    again = 0
    asked = replace(
        trial,
        seconds=layout.samples / PROBE_RATE_HZ + SPARE_S,
        watch=replace(trial.watch, random=False),
    )
    for number in range(layout.realisations):
        steps.next(f"realisation {number + 1} of {layout.realisations}")
        excitation = replace(trial.excitation, seed=trial.excitation.seed + number)
        found, tries = _one_realisation(replace(asked, excitation=excitation), layout, source)
        again += tries - 1
        if found.force_n.size >= layout.samples:
            whole.append(found)
        if found.ended:
            break
    steps.end()
    if not whole:
        raise too_short(found.seconds, found.ended)
    return _joined(whole, layout, found.ended, again)


def _one_realisation(
    asked: Trial, layout: MultisineLayout, source: Source
) -> tuple[TrialRecord, int]:
    """Record one realisation, and return the number of attempts with it."""
    for tries in range(1, TRIES + 1):
        found = source(asked, silent)
        if (
            found.ended
            or changing(found.force_n[: layout.samples].reshape(1, -1, PERIOD)) <= CHANGING
        ):
            return found, tries
    raise AnalysisError(
        f"the force did not repeat in {TRIES} tries of a realisation: the host stalls for"
        " milliseconds or samples are lost; see `hapticd doctor`, take fewer --periods, or noise"
    )


def multisine_spectra(recorded: TrialRecord, layout: MultisineLayout) -> PeriodicSpectra:
    """Return spectra of all complete realisations in a record of that layout. AnalysisError if
    there is none.
    """
    count = recorded.force_n.size // layout.samples
    if not count:
        raise AnalysisError(
            f"record of {recorded.seconds:.3g} s: a realisation of 1 + {layout.periods} periods of"
            f" {PERIOD} samples takes {layout.samples / recorded.rate_hz:.3g} s; record all of it,"
            " or give its --periods"
        )
    force, velocity = (
        channel[: count * layout.samples].reshape(count, layout.periods + 1, PERIOD)[:, 1:]
        for channel in (recorded.force_n, recorded.velocity_m_per_s)
    )
    return periodic(force, velocity, recorded.rate_hz)


def _joined(
    parts: list[TrialRecord], layout: MultisineLayout, ended: TrialEnd | None, again: int
) -> TrialRecord:
    force, velocity = (
        np.concatenate([channel[: layout.samples] for channel in channels])
        for channels in zip(*((part.force_n, part.velocity_m_per_s) for part in parts), strict=True)
    )
    commands = [part.max_command_n for part in parts if part.max_command_n is not None]
    return replace(
        parts[-1],
        force_n=force,
        velocity_m_per_s=velocity,
        ended=ended,
        max_command_n=max(commands, default=None),
        more={**parts[-1].more, "flown_again": again, **summed([part.more for part in parts])},
    )


@dataclass(frozen=True, slots=True)
class TrialParams:
    """The requested trial and its criteria. `scene` gives the device if there is a model of it,
    otherwise None.

    `multisine`: the excitation of `trial` is a multisine of that layout, in place of noise and a
    window of `lag` samples.
    """

    trial: Trial
    scene: Scene | None = None
    criteria: Criteria = field(default_factory=Criteria)
    lag: int = DEFAULT_LAG
    multisine: MultisineLayout | None = None


@dataclass(frozen=True, eq=False)
class TrialPlan:
    """`spectral_radius` of the predicted closed loop; None without a model, or with Coulomb
    friction, for which it is undefined.
    """

    params: TrialParams
    display: Display | None
    spectral_radius: float | None


@dataclass(frozen=True, eq=False)
class TrialResult:
    """The record, Z (at the port of the verdict), the prediction there, and the verdict. `spectra`,
    at the port of the probe, are those of the verdict: the window's, or those of the record
    (`resolved`).
    """

    plan: TrialPlan
    recorded: TrialRecord
    measured: Impedance
    predicted: Complexes | None
    verdict: Verdict
    spectra: Spectra


def plan_trial(params: TrialParams) -> TrialPlan:
    """Predict the trial. AnalysisError if it is too short for a verdict; ConfigError as
    `compose`.
    """
    _possible(params)
    trial = params.trial
    scene = params.scene
    shown = display(scene, trial.excitation) if scene else None
    radius = None  # unknown without a model, or with Coulomb friction
    if shown and not coulomb(shown.model).any():
        asked = np.array([trial.environment]), trial.active_damping_ns_per_m, shown.filters
        radius = float(spectral_radius(shown.model, *asked)[0])
    watch = replace(
        trial.watch, criteria=params.criteria, model=LoopModel(linear=radius is not None)
    )
    return TrialPlan(replace(params, trial=replace(trial, watch=watch)), shown, radius)


def _possible(params: TrialParams) -> None:
    trial = params.trial
    layout = params.multisine
    numbers = (
        *zip(
            ("stiffness", "virtual damping", "mass"),
            trial.environment,
            ("N/m", "N s/m", "kg"),
            strict=True,
        ),
        ("active damping", trial.active_damping_ns_per_m, "N s/m"),
        ("mass behind the port", params.criteria.behind_mass_kg, "kg"),
        ("skew", params.criteria.skew_s, "s"),
        ("high-pass corner", params.criteria.high_pass_hz, "Hz"),
    )
    for name, value, unit in numbers:
        if not isfinite(value):
            raise AnalysisError(f"{name} of {value:g} {unit}: a finite number is needed")
    psd = trial.excitation.psd_n2_per_hz
    hottest = trial.watch.winding_limit_c
    if not 0.0 < psd < inf:
        raise AnalysisError(
            f"perturbation of {psd:g} N^2/Hz: must be above 0; the paper's was about 2.5e-5"
        )
    if isnan(hottest):
        raise AnalysisError(f"winding limit of {hottest:g} degC: a number is needed; inf for none")
    if layout and (
        min(layout.realisations, layout.periods) < 1 or max(layout.realisations, layout.periods) < 2
    ):
        raise AnalysisError(
            f"{layout.realisations} realisations of {layout.periods} periods have no scatter to"
            " learn from; ask for two or more realisations"
        )
    least_s = SHORTEST_WINDOWS * params.lag / PROBE_RATE_HZ
    if not (layout or trial.seconds >= least_s):
        raise AnalysisError(
            f"a trial of {trial.seconds:g} s: a verdict takes {least_s:.3g} s or more; the paper"
            " took 90 s"
        )


def run_trial(plan: TrialPlan, source: Source, tell: Progress = silent) -> TrialResult:
    """Record and judge. AnalysisError if the record is too short for a verdict; otherwise as the
    source.
    """
    layout = plan.params.multisine
    trial = plan.params.trial
    return judged(
        plan, record_multisines(trial, layout, source, tell) if layout else source(trial, tell)
    )


def judged(plan: TrialPlan, recorded: TrialRecord) -> TrialResult:
    """Judge a record. AnalysisError if it is too short for a verdict."""
    params = plan.params
    layout = params.multisine
    measured = MeasuredTrial(
        multisine_spectra(recorded, layout) if layout else _windowed(params, recorded),
        (recorded.force_n, recorded.velocity_m_per_s),
        findings=tuple(_findings(recorded, params.trial)),
        simulated=recorded.simulated,
    )
    radius = plan.spectral_radius
    servo_rate_hz = params.scene.rate_hz if params.scene else None
    found = assess(measured, params.criteria, LoopModel(radius, radius is not None, servo_rate_hz))
    z = found.impedance
    return TrialResult(plan, recorded, z, _predicted(plan, z), found.verdict, found.spectra)


def _windowed(params: TrialParams, recorded: TrialRecord) -> Spectra:
    least_s = SHORTEST_WINDOWS * params.lag / recorded.rate_hz
    if recorded.ended and recorded.seconds < least_s:
        raise too_short(recorded.seconds, recorded.ended)
    if recorded.seconds < least_s:
        raise AnalysisError(
            f"{recorded.origin}: {recorded.seconds:.3g} s are too short for a verdict with a window"
            f" of {params.lag} samples; record {least_s:.3g} s or more"
        )
    return spa(recorded.force_n, recorded.velocity_m_per_s, recorded.rate_hz, params.lag)


def _findings(recorded: TrialRecord, trial: Trial) -> Iterator[Finding]:
    """Yield findings beyond the samples: the command at its limit, an escape seen by the monitor,
    losses, and K < 0, which is active at a low enough frequency, however long the record.
    """
    most = recorded.max_command_n
    limit = recorded.command_limit_n
    if most is not None and limit is not None and most >= limit * (1.0 - AT_LIMIT):
        message = f"command saturated at {limit:.3g} N; lower the perturbation or the stiffness"
        yield Finding("saturation", message, voids=True)
    ended = recorded.ended
    if ended and ended.reason is EndReason.ESCAPE:
        yield Finding("escape", str(ended), unstable=True)
    elif ended and ended.reason is not EndReason.DECIDED:
        voids = ended.reason in (EndReason.CHANGED, EndReason.TRAVEL)
        yield Finding("ended", str(ended), voids=voids)
    if (stiffness := trial.environment[0]) < 0.0:
        message = f"K = {stiffness:g} N/m: below every band a negative stiffness is active"
        yield Finding("negative_stiffness", message, voids=True)
    yield from loss_findings(recorded.more)
    yield from limit_findings(recorded.more)
    if doubts := recorded.more.get("calibration_doubts"):
        yield Finding("uncalibrated", f"uncalibrated: {'; '.join(doubts)}")


def _predicted(plan: TrialPlan, z: Impedance) -> Complexes | None:
    shown = plan.display
    trial = plan.params.trial
    at = z.frequency_hz > 0.0
    if shown is None:
        return None
    found = np.full(at.size, np.nan + 0j)
    asked = trial.active_damping_ns_per_m, shown.filters, shown.perturbation
    found[at] = predicted_impedance(shown.model, trial.environment, z.frequency_hz[at], *asked)
    return np.asarray(found - 2j * np.pi * z.frequency_hz * plan.params.criteria.behind_mass_kg)


def summary(result: TrialResult, sines: ReferenceSines | None = None) -> dict[str, Any]:
    """Return the verdict and everything that it depends on; SI units."""
    params = result.plan.params
    recorded = result.recorded
    stiffness, damping, mass = params.trial.environment
    return {
        "kind": "trial",
        "simulated": recorded.simulated,
        "origin": recorded.origin,
        "verdict": result.verdict,
        "sentence": str(result.verdict),
        "ended": recorded.ended,
        "environment": {
            "stiffness_n_per_m": stiffness,
            "virtual_damping_ns_per_m": damping,
            "mass_kg": mass,
        },
        "active_damping_ns_per_m": params.trial.active_damping_ns_per_m,
        "perturbation": params.trial.excitation,
        "estimator": result.measured.estimator,
        "interval_covers": result.spectra.covers,
        "lag": params.lag,
        "multisine": _multisine(result),
        "max_command_n": recorded.max_command_n,
        "command_limit_n": recorded.command_limit_n,
        "port": result.measured.port,
        "probe_mass_taken_out_kg": params.criteria.behind_mass_kg,
        "skew_taken_out_s": params.criteria.skew_s,
        "high_pass_taken_out_hz": params.criteria.high_pass_hz,
        "rate_hz": recorded.rate_hz,
        "seconds": recorded.seconds,
        "seed": params.trial.excitation.seed,
        "scene": params.scene.name if params.scene else None,
        "scene_hash": fingerprint(params.scene) if params.scene else None,
        **recorded.more,
        **({} if sines is None else {"stepped_sine": sines}),
    }


def _multisine(result: TrialResult) -> dict[str, Any] | None:
    """Layout of the record, and the scatter of the two kinds over the band."""
    if result.plan.params.multisine is None or not isinstance(result.spectra, PeriodicSpectra):
        return None
    periods, realisations = result.spectra.scatter(result.verdict.band_hz)
    return {
        "realisations": result.spectra.realisations,
        "periods": result.spectra.periods,
        "period_samples": PERIOD,
        "scatter_between_periods": periods,
        "scatter_between_realisations": realisations,
    }


def write(
    folder: Path,
    result: TrialResult,
    provenance: Mapping[str, Any],
    sines: ReferenceSines | None = None,
) -> Path:
    """Write the run folder. ConfigError if it cannot be written."""
    return write_run(
        folder,
        {**summary(result, sines), "provenance": provenance},
        result.recorded,
        {IMPEDANCE: impedance_csv(result.measured)},
    )


def kept_trial(folder: Path, kept: Mapping[str, Any], scene: Scene | None) -> TrialResult:
    """Return the trial in a run folder, judged again.

    `kept` is its run.json; `scene`, for a prediction, is None if it is no longer known.
    """
    recorded = replace(read_file(record_path(folder)), origin=kept["origin"])
    return judged(plan_trial(_kept_params(kept, scene)), recorded)


def _kept_params(kept: Mapping[str, Any], scene: Scene | None) -> TrialParams:
    stiffness, damping, mass = kept["environment"].values()
    low_hz, high_hz = kept["verdict"]["band_hz"]
    trial = Trial(
        (stiffness, damping, mass),
        kept["active_damping_ns_per_m"],
        kept["seconds"],
        Excitation(**kept["perturbation"]),
    )
    layout = kept["multisine"]
    criteria = Criteria(
        (low_hz, high_hz),
        kept["verdict"]["confidence"],
        kept["estimator"],
        kept["probe_mass_taken_out_kg"],
        kept["skew_taken_out_s"],
        kept["high_pass_taken_out_hz"],
    )
    multisine = MultisineLayout(layout["realisations"], layout["periods"]) if layout else None
    return TrialParams(trial, scene, criteria, kept["lag"], multisine)


def impedance_csv(measured: Impedance) -> str:
    """Return Z(f) as text: frequency, real and imaginary part, standard deviation of the complex
    value's random error (without the uncertainty of calibrations), coherence.
    """
    return csv_text(
        {
            "frequency_hz": measured.frequency_hz,
            "real_ns_per_m": measured.impedance_ns_per_m.real,
            "imaginary_ns_per_m": measured.impedance_ns_per_m.imag,
            "random_error_sd_ns_per_m": measured.sd_ns_per_m,
            "coherence": measured.coherence,
        }
    )
