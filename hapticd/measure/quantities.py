"""What a set of effects is judged by: passivity limits (`limits`), the phase of the impedance, or the peak of Fig. 8.

Each can be predicted (first harmonic, friction linearised: no noise) and simulated (the engine, with the same perturbation for
every set of effects, so that differences are those of the effects).

    phase    of Z under the scene's environment; change: the largest difference in the band over 90 degrees
    peak     highest |Z| between 40 and 200 Hz near the most negative passive mass, which owns the peak of Weir 2008, Fig. 8,
             and its frequency; change: the larger relative one of the two

A scene that noise does not move gets the paper's perturbation. Walls are left out: they have no impedance of their own.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from math import inf, nan

import numpy as np
import numpy.typing as npt

from hapticd.analysis.arrays import Complexes, Floats
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.predict import DEFAULT_BAND_HZ, predicted_impedance
from hapticd.errors import AnalysisError
from hapticd.measure.scenes import calm, filters, free_of_walls, frequencies, level, noise, perturbation, point, pooled, spectra_on
from hapticd.plant.compose import compose
from hapticd.plant.scene import Scene
from hapticd.sim.engine import BatchResult, simulate
from hapticd.sim.engine.shape import LANES

TOGETHER = LANES["f64"]
PEAK_HZ = (40.0, 200.0)


@dataclass(frozen=True)
class Quantity(ABC):
    """`full` is the scene with all its effects; `seconds` the length of a simulated trial."""

    full: Scene
    seconds: float = 90.0
    band_hz: tuple[float, float] = DEFAULT_BAND_HZ

    @abstractmethod
    def predicted(self, scene: Scene) -> Floats:
        """Its numbers for `full` with some of its effects."""

    @abstractmethod
    def simulated(self, scene: Scene) -> Floats:
        """The same, by simulation."""

    @abstractmethod
    def change(self, full: Floats, other: Floats) -> float:
        """Of `other` against `full`, 0.02 is 2 %; inf where only one of the two exists."""

    @abstractmethod
    def told(self, full: Floats, other: Floats) -> dict[str, float]:
        """Numbers of `other` by name with unit."""

    def exists(self, values: Floats) -> bool:
        """Whether the question has an answer at all."""
        return bool(np.isfinite(values).any())

    def perturbation(self) -> Perturbation:
        """Of the trials."""
        return perturbation(noise(self.full))

    def flown(self, scene: Scene, points: npt.ArrayLike, own_torque: bool) -> BatchResult:
        """Trials with records under these K, B, M (n, 3)."""
        return simulate(
            scene, points, self.seconds, damping=level(scene), environment=free_of_walls(scene), excitation=noise(scene),
            start=(0.0, 0.0), keep="records", own_torque=own_torque,
        )  # fmt: skip

    def impedance(self, scene: Scene, kbm: tuple[float, float, float], frequency_hz: Floats, simulated: bool) -> Complexes:
        """Z (F,) under one environment: predicted, or of a group of trials together."""
        if not simulated:
            return predicted_impedance(compose(scene), kbm, frequency_hz, level(scene), filters(scene), self.perturbation())
        found = self.flown(scene, [kbm] * TOGETHER, own_torque=True)
        return pooled([spectra_on(*found.record(trial), frequency_hz) for trial in calm(found, compose(scene).force_limit_n)])


@dataclass(frozen=True)
class Phase(Quantity):
    """Numbers: phase [deg] (F,)."""

    def predicted(self, scene: Scene) -> Floats:
        """By prediction."""
        return self._phase(scene, simulated=False)

    def simulated(self, scene: Scene) -> Floats:
        """By simulation."""
        return self._phase(scene, simulated=True)

    def change(self, full: Floats, other: Floats) -> float:
        """The largest difference over 90 degrees."""
        return float(np.abs(_turned(other - full)).max() / 90.0)

    def told(self, full: Floats, other: Floats) -> dict[str, float]:
        """The largest difference, and where."""
        turned = _turned(other - full)
        worst = int(np.argmax(np.abs(turned)))
        return {"phase deg": float(turned[worst]), "at Hz": float(frequencies(self.band_hz)[worst])}

    def _phase(self, scene: Scene, simulated: bool) -> Floats:
        z = self.impedance(scene, point(self.full), frequencies(self.band_hz), simulated)
        return np.degrees(np.angle(z))


@dataclass(frozen=True)
class Peak(Quantity):
    """Numbers: height [Ns/m], frequency [Hz], and whether it is a maximum inside the band (1) or its end (0).

    `mass_kg` < 0 is what is rendered.
    """

    mass_kg: float = field(default=0.0, kw_only=True)

    def predicted(self, scene: Scene) -> Floats:
        """By prediction."""
        return self._highest(scene, simulated=False)

    def simulated(self, scene: Scene) -> Floats:
        """By simulation."""
        return self._highest(scene, simulated=True)

    def change(self, full: Floats, other: Floats) -> float:
        """The larger relative one of height and frequency; inf if the peak came or went."""
        return inf if full[2] != other[2] else float(np.abs(other[:2] / full[:2] - 1.0).max())

    def told(self, full: Floats, other: Floats) -> dict[str, float]:
        """Height and place; no place where there is no maximum."""
        return {"peak N s/m": float(other[0]), "at Hz": float(other[1]) if other[2] else nan}

    def _highest(self, scene: Scene, simulated: bool) -> Floats:
        f = frequencies(PEAK_HZ, count=1000)
        size = np.abs(self.impedance(scene, (0.0, 0.0, self.mass_kg), f, simulated))
        rising = np.diff(size) > 0.0
        inner = np.flatnonzero(rising[:-1] & ~rising[1:]) + 1
        highest = int(inner[np.argmax(size[inner])]) if inner.size else int(np.argmax(size))
        return np.array([size[highest], f[highest], float(inner.size > 0)])


def _turned(degrees: Floats) -> Floats:
    """Into -180..180."""
    return np.asarray((degrees + 180.0) % 360.0 - 180.0)


def relative(full: float, other: float) -> float:
    """Change of `other` against `full`: inf where only one of them exists (nan), 0 where neither does."""
    if np.isnan(full) or np.isnan(other):
        return 0.0 if np.isnan(full) and np.isnan(other) else inf
    if full == 0.0:
        raise AnalysisError("a limit of 0 has no relative change; widen the band or strengthen the device")
    return abs(other / full - 1.0)
