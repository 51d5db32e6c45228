"""K, B and M limits of a scene's device, predicted and simulated: how far one of them goes before the display is not passive.

Axis limits, the other two being 0 (the paper's headline numbers; `analysis.boundary` has the other reading). A simulated trial
passes as in the paper: all phases within +-90 degrees in the band, and the force not saturated.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hapticd.analysis.arrays import Flags, Floats
from hapticd.analysis.boundary import axis_limit
from hapticd.analysis.predict import predict
from hapticd.analysis.spa import spa
from hapticd.measure.quantities import Quantity, relative
from hapticd.measure.scenes import calm, filters, level
from hapticd.plant.compose import compose
from hapticd.plant.scene import Scene
from hapticd.sim.engine import BatchResult

REACH = (2e4, 50.0, -0.2)  # of a predicted search: N/m, Ns/m, kg
WIDER = (2.0, 6.0, 18.0)  # times the predicted limit: of a simulated search, one after the other until it is enough
FINER = 15
NAMES = {"K N/m": 1.0, "B N s/m": 1.0, "M g": 1e3}

Decide = Callable[[Floats], Flags]


@dataclass(frozen=True)
class Limits(Quantity):
    """Numbers: K [N/m], B [Ns/m], M [kg] < 0; nan where K = B = M = 0 itself is not passive."""

    def predicted(self, scene: Scene) -> Floats:
        """By prediction."""
        model, own_level, own_filters = compose(scene), level(scene), filters(scene)

        def decide(points: Floats) -> Flags:
            return predict(model, points, own_level, own_filters, self.perturbation(), self.band_hz, recorded=True).passive

        return np.array([axis_limit(decide, axis, reach) for axis, reach in enumerate(REACH)])

    def simulated(self, scene: Scene) -> Floats:
        """By trials, each round 15 times finer."""
        limit_n = compose(scene).force_limit_n

        def decide(points: Floats) -> Flags:
            return passes(self.flown(scene, points, own_torque=False), self.band_hz, limit_n)

        return np.array([self._searched(decide, axis) for axis in range(len(REACH))])

    def change(self, full: Floats, other: Floats) -> float:
        """The largest relative one."""
        return max(relative(one, two) for one, two in zip(full, other, strict=True))

    def told(self, full: Floats, other: Floats) -> dict[str, float]:
        """K, B and M."""
        return {name: float(factor * value) for (name, factor), value in zip(NAMES.items(), other, strict=True)}

    @cached_property
    def _near(self) -> Floats:
        found = self.predicted(self.full)
        return np.where(np.isfinite(found) & (found != 0.0), found, 0.01 * np.asarray(REACH))

    def _searched(self, decide: Decide, axis: int) -> float:
        found = 0.0
        for times in WIDER:
            reach = times * float(self._near[axis])
            found = axis_limit(decide, axis, reach, steps=FINER)
            if found != reach:
                break
        return found


def passes(found: BatchResult, band_hz: tuple[float, float], force_limit_n: float | None) -> Flags:
    """Which trials (n,) are passive by the paper's rule."""
    good = calm(found, force_limit_n)
    return np.array([trial in good and _within_90_deg(found, trial, band_hz) for trial in range(len(found.params))])


def _within_90_deg(found: BatchResult, trial: int, band_hz: tuple[float, float]) -> bool:
    spectra = spa(*found.record(trial))
    inside = (spectra.frequency_hz >= band_hz[0]) & (spectra.frequency_hz <= band_hz[1])
    return bool((spectra.cross.real[inside] > 0.0).all())
