"""A trial on disk: its run folder with record and summary, and what the summary says."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hapticd.analysis.periodic import PeriodicSpectra
from hapticd.measure.multisine import PERIOD
from hapticd.measure.referee import Referee
from hapticd.measure.store import fingerprint, write_run
from hapticd.measure.trial import TrialResult

KIND = "trial"


def summary(result: TrialResult, referee: Referee | None = None) -> dict[str, Any]:
    """Verdict and everything that it depends on; SI units."""
    params, recorded = result.plan.params, result.recorded
    stiffness, damping, mass = params.trial.environment
    return {
        "kind": KIND,
        "simulated": recorded.simulated,
        "origin": recorded.origin,
        "verdict": result.verdict,
        "sentence": str(result.verdict),
        "ended": recorded.ended,
        "environment": {"stiffness_n_per_m": stiffness, "damping_ns_per_m": damping, "mass_kg": mass},
        "added_damping_ns_per_m": params.trial.damping_ns_per_m,
        "perturbation": params.trial.excitation,
        "estimator": result.measured.estimator,
        "interval_covers": result.covers,
        "lag": params.lag,
        "multisine": _multisine(result),
        "max_command_n": recorded.max_command_n,
        "command_limit_n": recorded.command_limit_n,
        "port": result.measured.port,
        "probe_mass_taken_out_kg": params.behind_mass_kg,
        "rate_hz": recorded.rate_hz,
        "seconds": recorded.seconds,
        "seed": params.trial.excitation.seed,
        "scene": params.scene.name if params.scene else None,
        "scene_hash": fingerprint(params.scene) if params.scene else None,
        **recorded.more,
        **({} if referee is None else {"stepped_sine": referee}),
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


def write(folder: Path, result: TrialResult, provenance: Mapping[str, Any], referee: Referee | None = None) -> Path:
    """The run folder."""
    return write_run(folder, {**summary(result, referee), "provenance": provenance}, result.recorded)
