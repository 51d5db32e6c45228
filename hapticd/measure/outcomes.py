"""Many trials at once by the batch engine, each reduced to what a campaign keeps: verdict, margins, Z at some 120 frequencies.

Trials are simulated and transformed together (`keep="spectra"`); no record is ever made. What `examine` reads off a record is
taken from sums: energy from the work of each tick, an escape from the rms velocity of every second.

A task travels as parameters and comes back as 5 kB a trial, so it may run in a thread or in another process; the same task
gives the same outcome wherever it runs. `passes` is the paper's rule: all phases within +-90 degrees, the loop calm, the
command not at its end. `answer` is the verdict with its intervals. A trial that diverged has no spectra.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, reduce
from math import inf, nan
from typing import Any

import numpy as np

from hapticd import __version__
from hapticd.analysis.arrays import Flags, Floats
from hapticd.analysis.diagnostics import Record, escape_findings
from hapticd.analysis.energy import Energy
from hapticd.analysis.envelope import Envelope, merged, of_one
from hapticd.analysis.impedance import impedance
from hapticd.analysis.passivity import DEFAULT_BAND_HZ, judge
from hapticd.analysis.predict import Prediction, predict
from hapticd.analysis.spa import DEFAULT_LAG
from hapticd.analysis.spectra import Spectra, grid_frequencies
from hapticd.errors import AnalysisError
from hapticd.measure.scenes import SATURATED, filters, free_of_walls, frequencies, perturbation
from hapticd.measure.store import fingerprint
from hapticd.plant.compose import compose
from hapticd.plant.scene import Excitation, Scene
from hapticd.sim.engine import BatchResult, simulate
from hapticd.sim.engine.shape import LANES

TOGETHER = LANES["f32"]  # trials of a task: the engine does as many at once
FREQUENCIES = 120
KEPT_BAND_HZ = (2.0, 1000.0)
NOISE = Excitation("noise")
FORMAT = 1  # of an outcome; part of its key


@dataclass(frozen=True, slots=True)
class Conditions:
    """What all trials of a campaign share but K, B, M and the damping level."""

    scene: Scene
    seconds: float = 90.0
    excitation: Excitation = NOISE
    band_hz: tuple[float, float] = DEFAULT_BAND_HZ
    confidence: float = 0.95
    substeps: int = 4
    dtype: str = "f32"


@dataclass(frozen=True, eq=False)
class Outcome:
    """One trial; `z` (F, 2) real and imaginary part [N s/m] and `relative_sd` (F,) at `kept_frequencies()`, empty if diverged."""

    environment: tuple[float, float, float]
    damping_ns_per_m: float
    answer: str
    passes: bool
    margin_ns_per_m: float
    margin_lower: float
    margin_upper: float
    margin_deg: float
    worst_hz: float
    velocity_sd: float
    max_force_n: float
    z: Floats
    relative_sd: Floats


Hear = Callable[[list[Outcome]], None]


@lru_cache
def kept_frequencies() -> Floats:
    """Frequencies (F,) of `Outcome.z`."""
    return frequencies(KEPT_BAND_HZ, FREQUENCIES)


@lru_cache
def _kept(rate_hz: float) -> Flags:
    """Which of the window's frequencies those are."""
    return np.isin(grid_frequencies(rate_hz, DEFAULT_LAG), kept_frequencies())


def key_of(shared: str, damping_ns_per_m: float, environment: tuple[float, float, float]) -> str:
    """Key of a trial in a store; `shared` is `fingerprint(conditions)`, the same for all of a campaign."""
    return fingerprint((FORMAT, __version__, shared, damping_ns_per_m, environment))[:32]


def predictor(conditions: Conditions, damping_ns_per_m: float) -> Callable[[Floats], Prediction]:
    """What is predicted of environments (N, 3), as a trial under `conditions` would record it. ConfigError as `compose`."""
    model, scene = compose(conditions.scene), conditions.scene
    return lambda points: predict(
        model, points, damping_ns_per_m, filters(scene), perturbation(conditions.excitation), conditions.band_hz, recorded=True
    )


def fly(conditions: Conditions, damping_ns_per_m: float, points: Floats) -> list[Outcome]:
    """Simulate and judge trials under `points` (n, 3). ConfigError as `simulate`, AnalysisError as `judge`."""
    found = simulate(
        conditions.scene, points, conditions.seconds, conditions.excitation.seed, damping=damping_ns_per_m,
        environment=free_of_walls(conditions.scene), excitation=conditions.excitation, start=(0.0, 0.0),
        substeps=conditions.substeps, dtype=conditions.dtype, keep="spectra",
    )  # fmt: skip
    limit_n = compose(conditions.scene).force_limit_n or inf
    return [_outcome(conditions, damping_ns_per_m, found, trial, limit_n) for trial in range(len(points))]


def _outcome(conditions: Conditions, damping: float, found: BatchResult, trial: int, limit_n: float) -> Outcome:
    k, b, m = (float(value) for value in found.params[trial])
    most, sd = float(found.max_force_n[trial]), float(found.sigma_v_m_per_s[trial])
    if found.diverged[trial]:
        nothing = np.empty(0)
        return Outcome((k, b, m), damping, "not_passive", False, nan, nan, nan, nan, nan, sd, most, nothing, nothing)
    spectra = found.spectra(trial)
    verdict = judge(spectra, _recorded(found, trial, spectra), conditions.band_hz, conditions.confidence, channels=False)
    doubtful = most >= SATURATED * limit_n or k < 0.0  # a K < 0 is active below every band
    z = impedance(spectra.part(_kept(found.rate_hz)))
    return Outcome(
        environment=(k, b, m),
        damping_ns_per_m=damping,
        answer="undecided" if doubtful and verdict.answer == "passive" else verdict.answer,
        passes=verdict.within_90_deg and verdict.stability != "unstable" and not doubtful,
        margin_ns_per_m=verdict.margin_ns_per_m.value,
        margin_lower=verdict.margin_ns_per_m.lower,
        margin_upper=verdict.margin_ns_per_m.upper,
        margin_deg=verdict.margin_deg.value,
        worst_hz=verdict.margin_ns_per_m.frequency_hz,
        velocity_sd=sd,
        max_force_n=most,
        z=np.column_stack((z.impedance_ns_per_m.real, z.impedance_ns_per_m.imag)),
        relative_sd=z.relative_sd,
    )


def _recorded(found: BatchResult, trial: int, spectra: Spectra) -> Record:
    assert found.section_rms_m_per_s is not None
    rms = found.section_rms_m_per_s[trial]
    pairs = np.sqrt(np.mean(rms[: rms.size // 2 * 2].reshape(-1, 2) ** 2, axis=1))
    flowed = Energy(float(found.min_energy_j[trial]), nan, float(found.work_j[trial]))
    findings = escape_findings(pairs, 2 * DEFAULT_LAG / found.rate_hz)
    return Record(spectra.n_samples / spectra.rate_hz, flowed, float(found.sigma_v_m_per_s[trial]), findings)


def kept(outcome: Outcome) -> dict[str, Any]:
    """An outcome as a store keeps it."""
    return {name: getattr(outcome, name) for name in outcome.__dataclass_fields__}


def restored(line: Mapping[str, Any]) -> Outcome:
    """An outcome from a store; what was not finite is nan."""
    values: dict[str, Any] = {name: nan if value is None else value for name, value in line.items()}
    values["environment"] = tuple(values["environment"])
    values["z"] = np.asarray(values["z"], np.float64).reshape(-1, 2)
    values["relative_sd"] = np.array([inf if value is None else value for value in values["relative_sd"]], np.float64)
    return Outcome(**values)


def envelope_of(outcomes: list[Outcome]) -> Envelope:
    """The envelope over the trials that pass, each point with the trial that owns it. AnalysisError if none does."""
    each = [_envelope(outcome) for outcome in outcomes if outcome.passes]
    if not each:
        raise AnalysisError("no trial passed: there is no envelope; begin with K = B = M = 0 and a longer trial")
    return reduce(merged, each)


def _envelope(outcome: Outcome) -> Envelope:
    k, b, m = outcome.environment
    name = f"K {k:.4g} N/m, B {b:.3g} N s/m, M {1e3 * m:.3g} g"
    return of_one(name, kept_frequencies(), outcome.z[:, 0] + 1j * outcome.z[:, 1], outcome.relative_sd, "probe", "spa")
