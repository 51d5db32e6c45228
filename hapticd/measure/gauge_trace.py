"""The gauge for scenes that are pushed: position, rms over the trial, in micrometres.

The reference is the same trial in double precision with 32 sub-steps per sample. What can be seen of a position is a count, so
the total error holds the encoder's rounding (quantum / sqrt(12)) as well.
"""

from dataclasses import replace
from math import floor

import numpy as np

from hapticd.analysis.arrays import Floats
from hapticd.errors import AnalysisError
from hapticd.measure.gauge import GROUP, Gauge, Reading, Setting
from hapticd.measure.lockstep_trial import fly
from hapticd.measure.scenes import point, without
from hapticd.measure.stopwatch import quickest, timed
from hapticd.plant.compose import compose
from hapticd.sim.engine import BatchResult, simulate
from hapticd.sim.engine.torque import torque_record
from hapticd.units import PROBE_RATE_HZ

UM_PER_M = 1e6
QUANTUM_M = 0.5e-6  # where the scene has no encoder: that of Weir 2008, section 2


class TraceGauge(Gauge):
    """Errors in micrometres."""

    unit = "um"
    quantity = "position, rms over the trial"

    def prepare(self) -> None:
        """Simulate the reference."""
        self._whole: dict[Setting, Floats] = {}
        self._model = compose(self.scene)
        self._floor = UM_PER_M * (self._model.encoder_quantum_m or QUANTUM_M) / np.sqrt(12.0)
        self._true = self._position(self._flown(self.exact, 1))

    @property
    def reference(self) -> str:
        """Simulated."""
        return f"the same trial, {self.exact.substeps} sub-steps, f64; position known to a count ({self._floor:.2g} um rms)"

    def read(self, setting: Setting) -> Reading:
        """One trial."""
        position = self._position(self._flown(setting, 1))
        if not setting.without:
            self._whole[setting] = position
        like = self._whole[replace(setting, without=())] if setting.without else self._true
        return self._reading(position - like)

    def cost(self, setting: Setting) -> float:
        """Of a group of equal trials."""
        return timed(self.now_ns, lambda: self._flown(setting, GROUP))[1] / GROUP

    def alone(self, setting: Setting) -> float:
        """One trial."""
        return quickest(self.now_ns, lambda: self._flown(setting, 1))[1]

    def lockstep(self, seconds: float) -> tuple[Reading, float]:
        """The push through the wire, compared with the engine under the forces that the probe then reported.

        AnalysisError for a scene that begins in motion: the stack begins at rest.
        """
        if self.scene.start_velocity_m_per_s or self.scene.start_position_m:
            raise AnalysisError("the scene begins in motion, lock-step at rest")
        samples, rate_hz = round(seconds * PROBE_RATE_HZ), self.scene.rate_hz
        torque = np.resize(torque_record(self.scene.excitation, samples, self.scene.excitation.seed), samples)
        steps = [(step.at_s, step.level_ns_per_m) for step in self.scene.damping]
        flown, spent = timed(self.now_ns, lambda: fly(str(self.source), torque, steps))
        lead, ticks = self._lead(), 1 if self._lead() else 0
        later = [(at_s + (ticks / rate_hz if at_s else 0.0), height) for at_s, height in steps]
        played = np.concatenate((np.zeros(lead), flown.torque_n))[:samples]
        like = simulate(
            self.scene, [point(self.scene)], seconds, damping=later, excitation=played, substeps=self.exact.substeps, keep="ticks"
        )
        position = self._position(like)
        return self._reading(flown.position_m[: len(position) - ticks] - position[ticks:]), spent

    def _lead(self) -> int:
        """Samples by which the engine's ticks, counted from the force, begin before those of the servo."""
        part = self._model.delay_periods % 1.0
        return floor((1.0 - part) * PROBE_RATE_HZ / self.scene.rate_hz) if part else 0

    def _flown(self, setting: Setting, trials: int) -> BatchResult:
        return simulate(
            without(self.scene, *setting.without), np.tile(point(self.scene), (trials, 1)), setting.seconds,
            substeps=setting.substeps, dtype=setting.dtype, keep="ticks",
        )  # fmt: skip

    def _position(self, found: BatchResult) -> Floats:
        assert found.position_m is not None
        return np.asarray(found.position_m[0], np.float64)

    def _reading(self, difference_m: Floats) -> Reading:
        step = UM_PER_M * float(np.sqrt(np.mean(difference_m**2)))
        return Reading(step, float(np.hypot(step, self._floor)))
