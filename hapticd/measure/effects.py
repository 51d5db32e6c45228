"""Which effects does a question need? Leave them out one at a time, see what the answer does, keep the cheapest set that does.

Linear effects are judged by prediction, which has no noise, others by simulation. All that alone change the answer by less than
the tolerance are then left out together, the least important first, as long as prediction agrees; what is left is simulated
against the whole scene, and the most important one comes back until that agrees as well.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import inf, nan

from hapticd.analysis.arrays import Floats
from hapticd.analysis.predict import DEFAULT_BAND_HZ
from hapticd.errors import AnalysisError, ConfigError
from hapticd.measure.cost import engine_cost
from hapticd.measure.limits import Limits
from hapticd.measure.progress import Progress, Steps, silent
from hapticd.measure.quantities import Peak, Phase, Quantity
from hapticd.measure.scenes import candidates, without
from hapticd.measure.stopwatch import Stopwatch
from hapticd.plant.scene import Scene

QUESTIONS = ("limits", "phase", "peak")
SECONDS = 90.0
INSIDE = 0.9  # of the predicted mass limit, for the peak: near it a long trial may run away
BACK = 6  # effects that may come back


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
    return EffectsPlan(
        params,
        _quantity(params),
        tuple(key for key in keys if key not in nonlinear),
        tuple(key for key in keys if key in nonlinear),
    )


def run_effects(plan: EffectsPlan, now_ns: Stopwatch, tell: Progress = silent) -> EffectsResult:
    """Measure. ConfigError as `compose` and `simulate`."""
    return _Study(plan, now_ns, tell).result()


def _quantity(params: EffectsParams) -> Quantity:
    scene, given = params.scene, (params.seconds, params.band_hz)
    if params.question == "phase":
        return Phase(scene, *given)
    limits = Limits(scene, *given)
    if params.question == "limits":
        return limits
    mass_kg = float(limits.predicted(scene)[2])
    if not mass_kg < 0.0:
        raise AnalysisError(
            f"scene {scene.name!r}: not passive even without an environment, so no mass owns a peak; ask for limits or phase"
        )
    return Peak(scene, *given, mass_kg=INSIDE * mass_kg)


class _Study:
    """One run: it remembers what the whole scene gave."""

    def __init__(self, plan: EffectsPlan, now_ns: Stopwatch, tell: Progress) -> None:
        self._plan, self._now_ns, self._quantity, self._scene = plan, now_ns, plan.quantity, plan.params.scene
        self._steps = Steps(tell, len(plan.predicted) + len(plan.simulated) + 4)
        self._full: dict[str, Floats] = {}
        self._costs: dict[tuple[str, ...], float] = {}

    def result(self) -> EffectsResult:
        """All of it."""
        whole = (self._whole("predicted"), self._whole("simulated"))
        rows = [self._left((key,), "predicted") for key in self._plan.predicted]
        rows += [self._left((key,), "simulated") for key in self._plan.simulated]
        rows.sort(key=lambda row: row.change, reverse=True)
        kept, proposal = self._proposal(rows)
        self._steps.end()
        return EffectsResult(self._plan, whole, tuple(rows), kept, proposal)

    def _whole(self, method: str) -> Left:
        self._steps.next(f"all effects, {method}")
        values = self._full[method] = self._values(method, self._scene)
        return Left("", method, self._quantity.told(values, values), 0.0, self._cost(()))

    def _left(self, keys: tuple[str, ...], method: str) -> Left:
        self._steps.next(f"without {', '.join(keys)}")
        try:
            values = self._values(method, without(self._scene, *keys))
        except (ConfigError, AnalysisError) as error:
            return Left(", ".join(keys), method, {}, inf, nan, str(error))
        full = self._full[method]
        return Left(
            ", ".join(keys), method, self._quantity.told(full, values), self._quantity.change(full, values), self._cost(keys)
        )

    def _values(self, method: str, scene: Scene) -> Floats:
        return self._quantity.predicted(scene) if method == "predicted" else self._quantity.simulated(scene)

    def _cost(self, keys: tuple[str, ...]) -> float:
        if keys not in self._costs:
            self._costs[keys] = engine_cost(without(self._scene, *keys), self._now_ns)
        return self._costs[keys]

    def _proposal(self, rows: list[Left]) -> tuple[tuple[str, ...], Left]:
        """The set that is kept and what it gives; everything where the question has no answer."""
        if not self._quantity.exists(self._full["predicted"]):
            return candidates(self._scene), self._whole("simulated")
        droppable = [row.effect for row in rows if row.change <= self._plan.params.tolerance]
        dropped = self._agreed(reversed(droppable))
        for _ in range(BACK):
            found = self._left(tuple(dropped), "simulated") if dropped else self._whole("simulated")
            if found.change <= self._plan.params.tolerance or not dropped:
                break
            dropped = dropped[:-1]
        kept = tuple(key for key in candidates(self._scene) if key not in dropped)
        return kept, replace(found, effect=", ".join(kept))

    def _agreed(self, keys: Iterable[str]) -> list[str]:
        """Those of `keys`, the least important first, that prediction lets go together."""
        dropped: list[str] = []
        for key in keys:
            try:
                values = self._quantity.predicted(without(self._scene, *dropped, key))
            except (ConfigError, AnalysisError):
                continue
            if self._quantity.change(self._full["predicted"], values) <= self._plan.params.tolerance:
                dropped.append(key)
        return dropped
