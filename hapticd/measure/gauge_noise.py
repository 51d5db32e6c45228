"""The gauge for scenes that noise moves: phase of the impedance, rms over the band.

The reference of a linear scene is its exact first harmonic (`analysis.loop`). Of any other it is simulated: a group of trials
of the scene's length, each with a perturbation of its own, in double precision with 32 sub-steps per sample, their spectra
added up under a window four times as long as the paper's. It is known to a third of the deviation of one trial, no better.
"""

from dataclasses import replace
from functools import cached_property

import numpy as np

from hapticd.analysis.arrays import Complexes, Floats
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.predict import predict, predicted_impedance
from hapticd.analysis.spa import DEFAULT_LAG, spa
from hapticd.analysis.spectra import Spectra
from hapticd.measure.gauge import GROUP, Gauge, Reading, Setting
from hapticd.measure.lockstep_trial import fly
from hapticd.measure.scenes import calm, display, filters, frequencies, is_linear, level, point, pooled, spectra_on, without
from hapticd.measure.stopwatch import quickest, timed
from hapticd.plant.compose import compose
from hapticd.sim.engine import BatchResult, simulate
from hapticd.sim.engine.torque import Stream, torque_record
from hapticd.units import PROBE_RATE_HZ

REFERENCE_LAG = 4 * DEFAULT_LAG
BATCH = 1000
ANALYSED = 8  # records whose analysis is timed


class NoiseGauge(Gauge):
    """Errors in degrees."""

    unit = "deg"
    quantity = "phase of Z, rms over the band"

    def prepare(self) -> None:
        """Simulate the reference, or compute it."""
        self._whole: dict[Setting, Complexes] = {}
        self._linear, self._limit_n = is_linear(self.scene), display(self.scene).force_limit_n
        flown = self._flown(self.exact, self._torque)
        self._step_free = pooled(self._spectra(flown, DEFAULT_LAG))
        if self._linear:
            self._true, self._known = self._exact(), 0.0
            return
        trials = self._spectra(flown, REFERENCE_LAG)
        half = len(trials) // 2
        self._true, self._known = pooled(trials), 0.5 * phase_rms(pooled(trials[half:]) / pooled(trials[:half]))

    @property
    def reference(self) -> str:
        """Exact or simulated."""
        if self._linear:
            return "exact first harmonic of the linear scene"
        return (
            f"{GROUP} trials of {self.seconds:g} s, {self.exact.substeps} sub-steps, f64, "
            f"window {REFERENCE_LAG}; known to {self._known:.2g} deg"
        )

    def read(self, setting: Setting) -> Reading:
        """A group of trials, their spectra together and one by one."""
        trials = self._spectra(self._flown(setting, self._torque), setting.lag)
        together = pooled(trials)
        if not setting.without:
            self._whole[setting] = together
        like = self._whole[replace(setting, without=())] if setting.without else self._step_free
        comparable = setting.seconds == self.seconds and setting.lag == DEFAULT_LAG
        step = phase_rms(together / like) if comparable else float("nan")
        return Reading(step, self._total(trials))

    def cost(self, setting: Setting) -> float:
        """Of simulation and spectra, these on the window's own grid."""
        found, simulated_s = timed(self.now_ns, lambda: self._flown(setting, self._torque))
        records = [found.record(int(trial)) for trial in np.flatnonzero(~found.diverged)[:ANALYSED]]
        _, analysed_s = timed(self.now_ns, lambda: [spa(*record, lag=setting.lag) for record in records])
        return simulated_s / GROUP + analysed_s / max(1, len(records))

    def alone(self, setting: Setting) -> float:
        """One trial and its spectra."""

        def ask() -> Spectra:
            found = self._flown(setting, self._torque[:1])
            return spectra_on(*found.record(0), self._f, setting.lag)

        return quickest(self.now_ns, ask)[1]

    def lockstep(self, seconds: float) -> tuple[Reading, float]:
        """Noise through the wire."""
        steps = [(step.at_s, step.level_ns_per_m) for step in self.scene.damping]
        torque = self._torque[0, : round(seconds * PROBE_RATE_HZ)]

        def ask() -> Spectra:
            found = fly(str(self.source), torque, steps)
            return spectra_on(found.torque_n, found.velocity_m_per_s, self._f)

        trial, spent = timed(self.now_ns, ask)
        return Reading(float("nan"), self._total([trial])), spent

    def predicted(self) -> tuple[Reading, float, float]:
        """Errors of the predicted Z, its seconds, and those of one of 1,000 environments that are asked for a verdict."""
        model, kbm, damping = compose(self.scene), point(self.scene), level(self.scene)
        z, spent = quickest(
            self.now_ns,
            lambda: predicted_impedance(model, kbm, self._f, damping, filters(self.scene), self._perturbation),
        )
        many = np.tile(kbm, (BATCH, 1))
        _, together = quickest(self.now_ns, lambda: predict(model, many, damping, filters(self.scene), self._perturbation))
        error = phase_rms(z / self._true)
        return Reading(error, error), spent, together / BATCH

    @cached_property
    def _f(self) -> Floats:
        return frequencies()

    @property
    def _perturbation(self) -> Perturbation:
        return Perturbation(self.scene.excitation.psd_n2_per_hz, self.scene.excitation.band_hz)

    def _exact(self) -> Complexes:
        return predicted_impedance(compose(self.scene), point(self.scene), self._f, level(self.scene), filters(self.scene))

    @cached_property
    def _torque(self) -> Floats:
        """(GROUP, samples), the same for every setting."""
        samples, source = round(self.seconds * PROBE_RATE_HZ), self.scene.excitation
        return np.stack([torque_record(source, samples, source.seed, Stream.TORQUE + trial) for trial in range(GROUP)])

    def _flown(self, setting: Setting, torque_n: Floats) -> BatchResult:
        return simulate(
            without(self.scene, *setting.without), np.tile(point(self.scene), (len(torque_n), 1)), setting.seconds,
            excitation=torque_n, own_torque=True, substeps=setting.substeps, dtype=setting.dtype, keep="records",
        )  # fmt: skip

    def _spectra(self, found: BatchResult, lag: int) -> list[Spectra]:
        """Of every trial that has some."""
        return [spectra_on(*found.record(trial), self._f, lag) for trial in calm(found, self._limit_n)]

    def _total(self, trials: list[Spectra]) -> float:
        """Of one trial: rms over trials and frequencies."""
        errors = [phase_rms(trial.cross / trial.velocity / self._true) for trial in trials]
        return float(np.sqrt(np.mean(np.square(errors)))) if errors else float("inf")


def phase_rms(ratio: Complexes) -> float:
    """rms phase [deg] of the ratio of two impedances (F,)."""
    return float(np.degrees(np.sqrt(np.mean(np.angle(ratio) ** 2))))
