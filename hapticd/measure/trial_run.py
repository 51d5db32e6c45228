"""A trial on disk: its run folder with record, summary and Z(f), and what the summary says.

run.json         verdict and everything that it depends on
impedance.csv    a line for each frequency that the estimate has, with the units in the head line; empty where not known
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hapticd.analysis.impedance import Impedance
from hapticd.analysis.periodic import PeriodicSpectra
from hapticd.measure.multisine import PERIOD
from hapticd.measure.referee import Referee
from hapticd.measure.store import IMPEDANCE, fingerprint, write_run
from hapticd.measure.trial import TrialResult

KIND = "trial"
COLUMNS = ("frequency_hz", "real_ns_per_m", "imaginary_ns_per_m", "sd_ns_per_m", "coherence")


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
        "skew_taken_out_s": params.skew_s,
        "high_pass_taken_out_hz": params.high_pass_hz,
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
    """The run folder. ConfigError if it cannot be written to."""
    texts = {IMPEDANCE: impedance_csv(result.measured)}
    return write_run(folder, {**summary(result, referee), "provenance": provenance}, result.recorded, texts)


def impedance_csv(measured: Impedance) -> str:
    """Z(f) as text: frequency, real and imaginary part, standard deviation of the complex value, coherence."""
    z = measured.impedance_ns_per_m
    columns = np.column_stack((measured.frequency_hz, z.real, z.imag, measured.sd_ns_per_m, measured.coherence))
    rows = (",".join(f"{value:.9g}" if np.isfinite(value) else "" for value in row) for row in columns)
    return "\n".join((",".join(COLUMNS), *rows, ""))
