"""Which effects does a question need? Leave them out one at a time, see what the answer does, keep the cheapest set that does.

Linear effects are judged by prediction, which has no noise, others by simulation. All that alone change the answer by less than
the tolerance are then left out together, the least important first, as long as prediction agrees; what is left is simulated
against the whole scene, and the most important one comes back until that agrees as well.

A set of effects is judged by one quantity, predicted (first harmonic, friction linearised: no noise) and simulated (the engine,
with the same perturbation for every set of effects, so that differences are those of the effects):

    limits   of K, B and M, each from 0 on (`measure.limits`); change: the largest relative one
    phase    of Z under the scene's environment; change: the largest difference in the band over 90 degrees
    peak     highest |Z| between 40 and 200 Hz near the most negative passive mass, which owns the peak of Weir 2008, Fig. 8,
             and its frequency; change: the larger relative one of the two

A scene that noise does not move gets the paper's perturbation. Walls are left out: they have no impedance of their own.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cache
from math import inf, nan

import numpy as np

from hapticd.analysis.arrays import Complexes, Floats
from hapticd.analysis.predict import DEFAULT_BAND_HZ, predicted_impedance
from hapticd.errors import AnalysisError, ConfigError
from hapticd.measure.accuracy import GROUP, Stopwatch, engine_cost
from hapticd.measure.limits import LimitsParams, plan_limits, run_limits
from hapticd.measure.outcomes import Conditions
from hapticd.measure.progress import Progress, Steps, silent
from hapticd.measure.scenes import (
    candidates,
    display,
    free_of_walls,
    frequencies,
    level,
    noise,
    point,
    pooled,
    spectra_of,
    without,
)  # fmt: skip
from hapticd.measure.store import TrialStore
from hapticd.plant.scene import Scene
from hapticd.sim.engine import simulate

PREDICTED, SIMULATED = ("predicted", "simulated")
PEAK_HZ = (40.0, 200.0)
NAMES = {"K N/m": 1.0, "B N s/m": 1.0, "M g": 1e3}
FINE = 1e-3  # of a limit: a change of 1 % is to be told from none
QUESTIONS = ("limits", "phase", "peak")
SECONDS = 90.0
INSIDE = 0.9  # of the predicted mass limit, for the peak: near it a long trial may run away
BACK = 6  # effects that may come back


@dataclass(frozen=True)
class Quantity(ABC):
    """`full` is the scene with all its effects; `seconds` the length of a simulated trial."""

    full: Scene
    seconds: float = SECONDS
    band_hz: tuple[float, float] = DEFAULT_BAND_HZ

    @abstractmethod
    def values(self, scene: Scene, method: str) -> Floats:
        """Its numbers for `full` with some of its effects, PREDICTED or SIMULATED."""

    @abstractmethod
    def change(self, full: Floats, other: Floats) -> float:
        """Of `other` against `full`, 0.02 is 2 %; inf where only one of the two exists."""

    @abstractmethod
    def told(self, full: Floats, other: Floats) -> dict[str, float]:
        """Numbers of `other` by name with unit."""

    def impedance(self, scene: Scene, kbm: tuple[float, float, float], frequency_hz: Floats, method: str) -> Complexes:
        """Z (F,) under one environment: predicted, or of a group of trials together."""
        own = display(scene, noise(self.full))
        if method == PREDICTED:
            return predicted_impedance(own.model, kbm, frequency_hz, level(scene), own.filters, own.perturbation)
        found = simulate(
            scene, [kbm] * GROUP, self.seconds, damping=level(scene), environment=free_of_walls(scene),
            excitation=own.excitation, start=(0.0, 0.0), keep="records", own_torque=True,
        )  # fmt: skip
        return pooled(spectra_of(found, frequency_hz, own.force_limit_n))


@dataclass(frozen=True)
class Limits(Quantity):
    """Numbers: K [N/m], B [Ns/m], M [kg] < 0; nan where K = B = M = 0 itself is not passive."""

    def values(self, scene: Scene, method: str) -> Floats:
        """By prediction, or by trials."""
        given = Conditions(scene, self.seconds, noise(self.full), self.band_hz)
        plan = plan_limits(LimitsParams(given, (level(scene),), tolerance=FINE))
        if method == PREDICTED:
            return np.array([scan.predicted for scan in plan.scans])
        return np.array([limit.value for limit in run_limits(plan, TrialStore(None)).limits])

    def change(self, full: Floats, other: Floats) -> float:
        """The largest relative one."""
        return max(relative(one, two) for one, two in zip(full, other, strict=True))

    def told(self, full: Floats, other: Floats) -> dict[str, float]:
        """K, B and M."""
        return {name: float(factor * value) for (name, factor), value in zip(NAMES.items(), other, strict=True)}


@dataclass(frozen=True)
class Phase(Quantity):
    """Numbers: phase [deg] (F,)."""

    def values(self, scene: Scene, method: str) -> Floats:
        """Under the scene's environment."""
        z = self.impedance(scene, point(self.full), frequencies(self.band_hz), method)
        return np.degrees(np.angle(z))

    def change(self, full: Floats, other: Floats) -> float:
        """The largest difference over 90 degrees."""
        return float(np.abs(_turned(other - full)).max() / 90.0)

    def told(self, full: Floats, other: Floats) -> dict[str, float]:
        """The largest difference, and where."""
        turned = _turned(other - full)
        worst = int(np.argmax(np.abs(turned)))
        return {"phase deg": float(turned[worst]), "at Hz": float(frequencies(self.band_hz)[worst])}


@dataclass(frozen=True)
class Peak(Quantity):
    """Numbers: height [Ns/m], frequency [Hz], and whether it is a maximum inside the band (1) or its end (0).

    `mass_kg` < 0 is what is rendered.
    """

    mass_kg: float = field(default=0.0, kw_only=True)

    def values(self, scene: Scene, method: str) -> Floats:
        """Of the highest maximum."""
        f = frequencies(PEAK_HZ, count=1000)
        size = np.abs(self.impedance(scene, (0.0, 0.0, self.mass_kg), f, method))
        rising = np.diff(size) > 0.0
        inner = np.flatnonzero(rising[:-1] & ~rising[1:]) + 1
        highest = int(inner[np.argmax(size[inner])]) if inner.size else int(np.argmax(size))
        return np.array([size[highest], f[highest], float(inner.size > 0)])

    def change(self, full: Floats, other: Floats) -> float:
        """The larger relative one of height and frequency; inf if the peak came or went."""
        return inf if full[2] != other[2] else float(np.abs(other[:2] / full[:2] - 1.0).max())

    def told(self, full: Floats, other: Floats) -> dict[str, float]:
        """Height and place; no place where there is no maximum."""
        return {"peak N s/m": float(other[0]), "at Hz": float(other[1]) if other[2] else nan}


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


@dataclass(frozen=True, slots=True)
class EffectsParams:
    """`question`: limits | phase | peak. `tolerance`: 0.02 is 2 %. `seconds`: of simulated trials."""

    scene: Scene
    question: str = "limits"
    tolerance: float = 0.02
    seconds: float = SECONDS
    band_hz: tuple[float, float] = DEFAULT_BAND_HZ


@dataclass(frozen=True, slots=True)
class EffectsPlan:
    """The quantity, and which effects are left out with which method."""

    params: EffectsParams
    quantity: Quantity
    predicted: tuple[str, ...]
    simulated: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Left:
    """The scene without `effect` ("" for the whole scene): its numbers by name and unit, their change, and the engine's cost.

    `method` is "predicted" or "simulated"; `note` says why it cannot be left out, if it cannot. `cost_s` per simulated second.
    """

    effect: str
    method: str
    numbers: dict[str, float]
    change: float
    cost_s: float
    note: str = ""


@dataclass(frozen=True, slots=True)
class EffectsResult:
    """`rows` from important to not; `kept` is the proposal, `proposal` its row (simulated); `whole` those of the scene."""

    plan: EffectsPlan
    whole: tuple[Left, Left]  # predicted, simulated
    rows: tuple[Left, ...]
    kept: tuple[str, ...]
    proposal: Left


def plan_effects(params: EffectsParams) -> EffectsPlan:
    """What will be left out how. ConfigError for an unknown question; AnalysisError if the scene does not answer it."""
    if params.question not in QUESTIONS:
        raise ConfigError(f"question {params.question!r}: use one of {', '.join(QUESTIONS)}")
    if not params.tolerance > 0.0:
        raise ConfigError(f"tolerance {params.tolerance:g}: must be above 0; 0.02 is 2 %")
    nonlinear = {effect.key for effect in params.scene.effects if effect.nonlinearity}
    keys = candidates(params.scene)
    predicted = tuple(key for key in keys if key not in nonlinear)
    simulated = tuple(key for key in keys if key in nonlinear)
    return EffectsPlan(params, _quantity(params), predicted, simulated)


def _quantity(params: EffectsParams) -> Quantity:
    scene, given = params.scene, (params.scene, params.seconds, params.band_hz)
    if params.question != "peak":
        return Phase(*given) if params.question == "phase" else Limits(*given)
    mass_kg = float(Limits(*given).values(scene, PREDICTED)[2])
    if not mass_kg < 0.0:
        raise AnalysisError(
            f"scene {scene.name!r}: not passive even without an environment, so no mass owns a peak; ask for limits or phase"
        )
    return Peak(*given, mass_kg=INSIDE * mass_kg)


def run_effects(plan: EffectsPlan, now_ns: Stopwatch, tell: Progress = silent) -> EffectsResult:
    """Measure. ConfigError as `compose` and `simulate`."""
    study = _Study(plan, Steps(tell, len(plan.predicted) + len(plan.simulated) + 4), now_ns)
    whole = (study.left((), PREDICTED), study.left((), SIMULATED))
    rows = [study.left((key,), PREDICTED) for key in plan.predicted]
    rows += [study.left((key,), SIMULATED) for key in plan.simulated]
    rows.sort(key=lambda row: row.change, reverse=True)
    kept, proposal = study.proposal(rows)
    study.steps.end()
    return EffectsResult(plan, whole, tuple(rows), kept, proposal)


class _Study:
    """One run: it remembers what the whole scene gave, which is asked first, and what was timed."""

    def __init__(self, plan: EffectsPlan, steps: Steps, now_ns: Stopwatch) -> None:
        self.steps, self._quantity = steps, plan.quantity
        self._scene, self._tolerance = plan.params.scene, plan.params.tolerance
        self._full: dict[str, Floats] = {}
        self._cost = cache(lambda keys: engine_cost(without(self._scene, *keys), now_ns))

    def left(self, keys: tuple[str, ...], method: str) -> Left:
        """The scene without `keys`; the whole scene if there are none."""
        words = ", ".join(keys)
        self.steps.next(f"without {words}" if keys else f"all effects, {method}")
        try:
            values = self._quantity.values(without(self._scene, *keys), method)
        except (ConfigError, AnalysisError) as error:
            if not keys:
                raise
            return Left(words, method, {}, inf, nan, str(error))
        full = self._full[method] = self._full[method] if keys else values
        change = self._quantity.change(full, values) if keys else 0.0
        return Left(words, method, self._quantity.told(full, values), change, self._cost(keys))

    def proposal(self, rows: list[Left]) -> tuple[tuple[str, ...], Left]:
        """The set that is kept and what it gives; everything where the question has no answer."""
        droppable = [row.effect for row in rows if row.change <= self._tolerance]
        answered = np.isfinite(self._full[PREDICTED]).any()
        dropped = self._agreed(reversed(droppable)) if answered else []
        found = self.left(tuple(dropped), SIMULATED)
        for _ in range(BACK):
            if found.change <= self._tolerance:
                break
            dropped = dropped[:-1]
            found = self.left(tuple(dropped), SIMULATED)
        kept = tuple(key for key in candidates(self._scene) if key not in dropped)
        return kept, replace(found, effect=", ".join(kept))

    def _agreed(self, keys: Iterable[str]) -> list[str]:
        """Those of `keys`, the least important first, that prediction lets go together."""
        dropped: list[str] = []
        for key in keys:
            try:
                values = self._quantity.values(without(self._scene, *dropped, key), PREDICTED)
            except (ConfigError, AnalysisError):
                continue
            if self._quantity.change(self._full[PREDICTED], values) <= self._tolerance:
                dropped.append(key)
        return dropped
