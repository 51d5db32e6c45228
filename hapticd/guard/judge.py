"""The judge in the guard's worker: answers to the requests of the gateway, and the K-B plane.

Plane (`plane`). It is the range of B at which each K is stable in every passive hand. A plane has
one virtual mass, one pair of filters and one level of active damping. The basis of the guard
(`model.bases`) judges a grid of K and B, so a picture of the plane agrees with the guard's
verdicts. For each K the safe values of B are taken as one interval, the longest run. The set of the
theorem is convex for a rigid device. At one delay it was an interval in B for all devices that were
examined. Limitations: an interval of B narrower than a step of the grid is not found.

Answers (`Judge`). It takes and returns plain maps (docs/guard.md). It judges a `change` at its end
and at up to 20 points of its path (`transition_planner`). It does so in free space and in contact
(`safe_region`), on the requested basis (`model.bases`); the policy selects the answer (`policies`).
A `look` returns the verdict on the environment in force and the cost of the delay. A `hand` returns
the passive hand that destabilises an environment. The answer depends on request and setup alone:
tests and lock-step runs rely on it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from hapticd.core.arrays import Flags, Floats
from hapticd.core.environment import FURTHER, Environment, Point
from hapticd.core.errors import AnalysisError
from hapticd.core.params import EnvironmentLimits
from hapticd.guard.policies import answer_change
from hapticd.guard.safe_region import (
    IDEAL_PERIODS,
    SafeRegion,
    VerdictBuilder,
    doubling_text,
    explain,
    hand_text,
    timing_cost,
)
from hapticd.guard.transition_planner import from_message
from hapticd.model.angles import unresolved_hz
from hapticd.model.bases import Basis, Conditions, Measured, Predicted, Theorem, model_of
from hapticd.model.coupled import shaking_hand
from hapticd.model.linearise import Perturbation
from hapticd.model.params import GuardSetup
from hapticd.protocol.journal import Explanation, Outcome, Reason, Remedy

__all__ = ["Judge"]

# --- plane ----------------------------------------------------------------------------------------

_COLUMNS = 60  # values of K
_ROWS = 41  # values of B
_HALVINGS = 5  # of a step of B, towards an edge
_ROOM = 1.25  # length of the axes relative to the safe set and to the environment in force


def plane(
    region: SafeRegion, environment: Environment, level_on: float, most_k: float, most_b: float
) -> dict[str, Any]:
    """Return the edges of the safe B over K, without active damping and with `level_on` [N s/m].

    {K: [..], without: {level, low, high}, with: {level, low, high}, B: [lowest, highest of the
    axis]}; `low` and `high` contain None where no B is safe. `most_k` [N/m] and `most_b` [N s/m]
    bound the axes.
    """
    stiffness, damping = _axes(region, environment, level_on, most_k, most_b)
    found = {
        name: {"level": level, **_edges(region, environment, level, stiffness, damping)}
        for name, level in (("without", 0.0), ("with", level_on))
    }
    return {"K": stiffness.tolist(), "B": [float(damping[0]), float(damping[-1])], **found}


def _axes(
    region: SafeRegion, environment: Environment, level_on: float, most_k: float, most_b: float
) -> tuple[Floats, Floats]:
    """Return K from 0 and B around 0, with the safe set and the environment in force inside."""
    free = replace(
        environment,
        stiffness_n_per_m=0.0,
        virtual_damping_ns_per_m=0.0,
        active_damping_ns_per_m=level_on,
    )
    mass_kg = environment.mass_kg
    limits = EnvironmentLimits((0.0, -most_b, mass_kg), (most_k, most_b, mass_kg))
    alone = region.allowed(free, limits)
    low, high = alone["B"] or [-1.0, 1.0]
    middle = replace(free, virtual_damping_ns_per_m=0.5 * (low + high))
    farthest = max(_end(alone["K"]), _end(region.allowed(middle, limits)["K"]), 1.0)
    stiffest = _ROOM * max(farthest, min(environment.stiffness_n_per_m, 4.0 * farthest))
    reach = _ROOM * max(
        -low, high, min(abs(environment.virtual_damping_ns_per_m), 4.0 * max(-low, high))
    )
    bottom = max(-reach, 2.0 * min(low, environment.virtual_damping_ns_per_m, -0.1 * reach))
    return np.linspace(0.0, stiffest, _COLUMNS), np.linspace(bottom, reach, _ROWS)


def _end(interval: list[float] | None) -> float:
    return interval[1] if interval else 0.0


def _edges(
    region: SafeRegion, environment: Environment, level: float, stiffness: Floats, damping: Floats
) -> dict[str, list[float | None]]:
    damped = replace(environment, active_damping_ns_per_m=level)

    def safe(at_k: Floats, at_b: Floats) -> Flags:
        points = np.column_stack((at_k, at_b, np.full(len(at_k), environment.mass_kg)))
        flags = np.ones(len(points), np.bool_)
        for at in region.conditions(damped):
            flags &= region.basis.safe(points, at)
        return flags

    grid = safe(np.repeat(stiffness, len(damping)), np.tile(damping, len(stiffness)))
    runs = [_longest(row) for row in grid.reshape(len(stiffness), -1)]
    edges: dict[str, list[float | None]] = {}
    for name, end, step in (("low", 0, -1), ("high", 1, 1)):
        known = [column for column, run in enumerate(runs) if run is not None]
        inside = np.array([(runs[column] or (0, 0))[end] for column in known], np.int64)
        outside = np.clip(inside + step, 0, len(damping) - 1)
        values = _bisected(safe, stiffness[known], damping[inside], damping[outside])
        edges[name] = [None] * len(stiffness)
        for column, value in zip(known, values.tolist(), strict=True):
            edges[name][column] = value
    return edges


def _bisected(
    safe: Callable[[Floats, Floats], Flags], stiffness: Floats, inside: Floats, outside: Floats
) -> Floats:
    """Return the last safe B between a safe and an unsafe one, for each K (n,)."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (inside + outside)
        held = safe(stiffness, middle)
        inside = np.where(held, middle, inside)
        outside = np.where(held, outside, middle)
    return inside


def _longest(safe: Flags) -> tuple[int, int] | None:
    """Return the first and last index of the longest run of true flags; None without any."""
    held = np.flatnonzero(safe)
    if not held.size:
        return None
    runs = np.split(held, np.flatnonzero(np.diff(held) > 1) + 1)
    longest = max(runs, key=len)
    return int(longest[0]), int(longest[-1])


# --- answers --------------------------------------------------------------------------------------

_DELAYS = 8  # with a cached cost
_TERMS = {"ask", "n", "delay_periods", "basis", "margin_ns_per_m"}
_CHANGE = {"state", "gain", "enable", "change", "before", "after", "policy", "mode", "level"}
_FIELDS = {  # of a request
    "change": {*_TERMS, *_CHANGE, "now", "wall_virtual_dampings", "target", "ramp_s"},
    "look": {*_TERMS, "now", "target", "level_on"},
    "hand": {"ask", "n", "environment", "delay_periods"},
    "plane": {*_TERMS, "target", "level_on"},
}


class Judge:
    """Answer requests about environments on the device of `setup`; plain maps in and out.

    The same requests give the same answers. AnalysisError for an invalid request.
    """

    def __init__(self, setup: GuardSetup) -> None:
        self.setup = setup
        self.verdicts = VerdictBuilder(setup)
        self.theorem = None if setup.model is None else Theorem(model_of(setup.model))
        self._unresolved = self._narrow_modes()
        self._cold = list(self.verdicts.levels)
        self._warm_delay = self._delay(None)
        self._timing: Callable[[float], dict[str, Any] | None] = lru_cache(_DELAYS)(self._timed)

    def hello(self, pid: int) -> dict[str, Any]:
        """Return the first message of the worker."""
        return {
            "hello": {
                "model": self.theorem is not None,
                "model_hash": self.setup.model_hash,
                "config_hash": self.setup.config_hash,
                "basis": self.setup.guard.basis,
                "delay_periods": self.theorem and self.theorem.model.delay_periods,
                "pid": pid,
            }
        }

    def warm(self) -> bool:
        """Prepare one more level for the delay of the last request; return False when
        none is left.
        """
        if self.theorem is None or not self._cold:
            return False
        spare = self.setup.guard.margin_ns_per_m
        filters = self.setup.environment.filters
        self.theorem.prepare(Conditions(self._cold.pop(0), filters, self._warm_delay, spare))
        return bool(self._cold)

    def answer(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer to one request: `change`, `look`, `hand` or `plane`."""
        asks = {
            "change": self._change,
            "look": self._look,
            "hand": self._hand,
            "plane": self._plane,
        }
        ask = request.get("ask")
        if ask not in asks:
            raise AnalysisError(f"the guard is asked {ask!r}; it knows {', '.join(asks)}")
        if strange := request.keys() - _FIELDS[ask]:
            raise AnalysisError(f"{ask}: the guard knows no field {min(strange)!r}")
        return {"n": request.get("n"), **asks[ask](request)}

    # --- requests ---------------------------------------------------------------------------------

    def _change(self, request: Mapping[str, Any]) -> dict[str, Any]:
        return answer_change(self.verdicts, self._region(request), request)

    def _look(self, request: Mapping[str, Any]) -> dict[str, Any]:
        region = self._region(request)
        target = from_message(request["target"], self.setup.environment)
        timing = {"timing": self._timing(self._delay(request.get("delay_periods")))}
        if isinstance(region, Explanation):
            nothing: dict[str, Any] = {"margin_ns_per_m": None, "allowed": {}}
            return timing | {
                "verdict": self.verdicts.of(None, target, "", Outcome.UNKNOWN, region, [], target),
                "without_active_damping": nothing,
                "with_active_damping": {"level": request["level_on"], **nothing},
            }
        safe = region.safe([target])[0]
        on = min(float(request["level_on"]), self.setup.active_damping_limit_ns_per_m)
        outcome = Outcome.SAFE if safe else Outcome.UNSAFE
        why = explain(region, target, safe)
        return timing | {
            "verdict": self.verdicts.of(region, target, "", outcome, why, [target], target),
            "without_active_damping": self._seen(
                region, replace(target, active_damping_ns_per_m=0.0)
            ),
            "with_active_damping": {
                "level": on,
                **self._seen(region, replace(target, active_damping_ns_per_m=on)),
            },
        }

    def _seen(self, region: SafeRegion, environment: Environment) -> dict[str, Any]:
        worse = region.worse(environment)
        allowed = region.allowed(environment, self.setup.limits)
        return {"margin_ns_per_m": worse.margin_ns_per_m, "allowed": allowed}

    def _timed(self, delay: float) -> dict[str, Any] | None:
        """Return the stiffness lost to a delay [periods] by the theorem; None without a usable
        model. It is given without active damping and with the level of `damping on`.
        """
        if self.theorem is None or self._unresolved:
            return None
        filters = self.setup.environment.filters
        delays = delay, min(delay, self._delay(None))
        on = min(self.setup.active_damping_ns_per_m, self.setup.active_damping_limit_ns_per_m)
        return {
            "delay_periods": delay,
            "ideal_delay_periods": IDEAL_PERIODS,
            "without_active_damping": timing_cost(self.theorem, filters, 0.0, delays),
            "with_active_damping": timing_cost(self.theorem, filters, on, delays),
        }

    def _plane(self, request: Mapping[str, Any]) -> dict[str, Any]:
        region = self._region(request)
        if isinstance(region, Explanation):
            return {"plane": None, "text": region.plain(Outcome.UNKNOWN)["text"]}
        environment = from_message(request["target"], self.setup.environment)
        on = min(float(request["level_on"]), self.setup.active_damping_limit_ns_per_m)
        most_k, most_b, _ = self.setup.limits.highest
        return {"plane": plane(region, environment, on, most_k, most_b)}

    def _hand(self, request: Mapping[str, Any]) -> dict[str, Any]:
        environment = from_message(request["environment"], self.setup.environment)
        if self.theorem is None or _beyond_the_model([environment]):
            return {"hand": None}
        delay = self._delay(request.get("delay_periods"))
        found = [
            self._shakers(self.theorem, delay, point, environment, in_wall=place == 1)
            for place, point in enumerate(environment.points())
            if point[0] >= 0.0
        ]
        hands = [one for ones in found for one in ones]
        return {"hand": max(hands, key=lambda one: float(one["radius"]), default=None)}

    @staticmethod
    def _shakers(
        theorem: Theorem, delay: float, point: Point, environment: Environment, in_wall: bool
    ) -> list[dict[str, Any]]:
        """Return hands that destabilise the environment. One is placed where the motion grows
        fastest, one where the most damping is missing: either may be the one that shakes the device
        hardest.
        """
        level = environment.active_damping_ns_per_m
        filters = environment.filters
        model = theorem.late(delay)
        worst = theorem.reading(point, Conditions(level, filters, delay, 0.0))
        found: list[dict[str, Any]] = []
        for at_hz in (None, worst.worst_hz):
            shaker = shaking_hand(model, np.array(point), level, filters, at_hz)
            if shaker is not None:
                grows = doubling_text(shaker.radius, model.rate_hz)
                how = {"hz": shaker.hz, "radius": shaker.radius, "growth": f"its motion {grows}"}
                found.append(hand_text(shaker.hand, shaker.hz, in_wall) | how)
        return found

    # --- parts ------------------------------------------------------------------------------------

    def _delay(self, asked: float | None) -> float:
        if asked is not None:
            return float(asked)
        return 0.0 if self.theorem is None else self.theorem.model.delay_periods

    def _region(self, request: Mapping[str, Any]) -> SafeRegion | Explanation:
        """Return the region to judge by, or the reason why the request cannot be judged."""
        # this test walks the whole change: do it only if there are such parameters
        if FURTHER and (beyond := _beyond_the_model(self._concerned(request))):
            return beyond
        found = self._basis(request["basis"])
        if isinstance(found, Explanation):
            return found
        delay = self._delay(request.get("delay_periods"))
        if delay != self._warm_delay:
            self._warm_delay = delay
            self._cold = list(self.verdicts.levels)
        spare = float(request["margin_ns_per_m"])
        return SafeRegion(found, (delay, min(delay, self._delay(None))), spare)

    def _concerned(self, request: Mapping[str, Any]) -> list[Environment]:
        """Return the environments that `request` and all scheduled changes lead to; with force also
        those before.
        """
        target = from_message(request["target"], self.setup.environment)
        on_the_way = [target]
        for one in (*request.get("before", ()), request.get("change", {})):
            on_the_way.append(on_the_way[-1].changed(one))
        ends = [on_the_way[-1]]
        for one in request.get("after", ()):
            ends.append(ends[-1].changed(one))
        if not request.get("enable") and request.get("state") != "enabled":
            return ends
        now = from_message(request.get("now", {}), self.setup.environment)
        return [now, *on_the_way, *ends]

    def _narrow_modes(self) -> Explanation | None:
        """Return why modes of the model are too narrow to judge; None if none is."""
        if self.theorem is None:
            return None
        found = [unresolved_hz(self.theorem.model, level) for level in self.verdicts.levels]
        modes = max(found, key=len)
        if not modes:
            return None
        listed = ", ".join(f"{hz:.4g}" for hz in modes)
        return _unknown(
            f"the device's model has modes without loss, at {listed} Hz with the probe held, that"
            " no test can resolve",
            "give them the damping that they have",
        )

    def _basis(self, asked: str) -> Basis | Explanation:
        if asked == "measured":
            measured = self.setup.measured
            if measured is None:
                return _unknown("no .zwidth file is named", "set [guard] measured")
            if measured.refused:
                return _unknown(f"{measured.file} does not count: {measured.refused}")
            return Measured(measured)
        if asked not in ("theorem", "predicted"):
            raise AnalysisError(f"basis {asked!r}; there are theorem, predicted and measured")
        if self.theorem is None:
            return _unknown(
                "this device has no model",
                "give its file a [model], or measure it and set [guard] basis = 'measured'",
            )
        if self._unresolved:
            return self._unresolved
        if asked == "theorem":
            return self.theorem
        return Predicted(self.theorem, Perturbation(self.setup.psd_n2_per_hz, self.setup.band_hz))


def _unknown(text: str, remedy: str = "") -> Explanation:
    why = Explanation.because(Reason.UNKNOWN, f"unknown: {text}")
    return why.and_remedy(Remedy.CONFIGURE, remedy) if remedy else why


def _beyond_the_model(environments: Sequence[Environment]) -> Explanation | None:
    """Return the reason if `environments` use parameters that the model does not cover; None
    otherwise.
    """
    values = zip(*(one.further for one in environments), strict=True)
    beyond = [one.key for one, found in zip(FURTHER, values, strict=False) if any(found)]
    if not beyond:
        return None
    names = " and ".join(beyond)
    text = f"the guard's model is linear and knows nothing of {names}"
    return _unknown(text, f"set {names} to 0 while force is off")
