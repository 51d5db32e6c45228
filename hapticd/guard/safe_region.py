"""The safe region of a device: safe environments, their margins and ranges, and their verdicts.

Region (`SafeRegion`). It gives the safe environments, their margin, and the allowed ranges of K, B
and M. It also gives the passive range of each parameter alone, and the stiffness that the delay
costs. An environment is safe if the basis (`model.bases`) judges its K, B, M safe in free space and
in its wall, at each delay considered. The grid for a range gets finer towards the environment's own
value. Each end is then refined between its last two grid points. Limitations: a delay that changes
from tick to tick; a hand that makes and breaks contact with the wall in step with its motion,
because each side is judged separately; a device that renders nothing of one axis alone, and much of
it together with another.

Verdict (`VerdictBuilder`, `explain`). It is a plain map with reasons and remedies, and the
destabilising hand. Each sentence must have value, unit and remedy. A `safe` verdict must include
the list NOT_COVERED.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import log
from typing import Any

import numpy as np

from hapticd.core.arrays import Flags, Floats
from hapticd.core.environment import Environment, FilterParams, Point
from hapticd.core.params import EnvironmentLimits
from hapticd.guard.transition_planner import AXES
from hapticd.model.bases import Basis, Conditions, Reading, Theorem, cached_levels, model_of
from hapticd.model.coupled import Hand
from hapticd.model.model import Model
from hapticd.model.params import GuardSetup
from hapticd.protocol.journal import Explanation, Outcome, Reason, Remedy
from hapticd.protocol.limits import WIDEST

__all__ = ["passive_ranges", "ranges_of"]

# --- region ---------------------------------------------------------------------------------------

_GRID = 40  # grid distances on either side of a value
_FINER = 9  # values between the last safe and the first unsafe one, three times
_INSIDE = 1e-3  # of an interval: distance of a check from its end
NONE = np.zeros(0)
IDEAL_PERIODS = 0.0  # the force acts at its sample; only the hold remains as a delay

Ranges = dict[str, list[float] | None]  # of K, B and M, from and to; None: no passive value


@dataclass(frozen=True)
class SafeRegion:
    """Displays judged on one basis, with one required margin, at one or two delays.

    A longer delay makes a negative virtual mass easier to render, so the longest alone is not the
    worst case.
    """

    basis: Basis
    delays_periods: tuple[float, ...]  # the longest first
    spare_ns_per_m: float

    def conditions(self, environment: Environment) -> list[Conditions]:
        """Return the conditions of one environment, by delay."""
        return [
            Conditions(
                environment.active_damping_ns_per_m, environment.filters, delay, self.spare_ns_per_m
            )
            for delay in dict.fromkeys(self.delays_periods)
        ]

    def safe(self, environments: Sequence[Environment]) -> list[bool]:
        """Return whether each environment is safe, in free space and in contact."""
        found = [True] * len(environments)
        groups: dict[Conditions, list[tuple[int, Point]]] = {}
        for place, environment in enumerate(environments):
            for at in self.conditions(environment):
                rows = groups.setdefault(at, [])
                rows.extend((place, point) for point in environment.points())
        for at, rows in groups.items():
            flags = self.basis.safe(np.array([point for _, point in rows]), at)
            for (place, _), flag in zip(rows, flags.tolist(), strict=True):
                found[place] = found[place] and flag
        return found

    def all_safe(self, path: Sequence[Environment]) -> bool:
        """Return whether a path is safe; a path without points is not known to be."""
        return bool(path) and all(self.safe(path))

    def reading(self, environment: Environment) -> Reading:
        """Return the safety in free space."""
        return self._read(environment.free, environment)

    def in_contact(self, environment: Environment) -> Reading | None:
        """Return the safety in the wall; None without one."""
        point = environment.contact
        return None if point is None else self._read(point, environment)

    def _read(self, point: Point, environment: Environment) -> Reading:
        found = [self.basis.reading(point, at) for at in self.conditions(environment)]
        known = [one for one in found if one.margin_ns_per_m is not None]
        return min(known, key=lambda one: one.margin_ns_per_m or 0.0) if known else found[0]

    def worse(self, environment: Environment) -> Reading:
        """Return the reading of free space or contact with the smaller margin."""
        free = self.reading(environment)
        contact = self.in_contact(environment)
        if contact is None or contact.margin_ns_per_m is None or free.margin_ns_per_m is None:
            return free
        return contact if contact.margin_ns_per_m < free.margin_ns_per_m else free

    def least_level(self, environment: Environment, levels: Sequence[float]) -> float | None:
        """Return the lowest of `levels` (rising) at which the environment is safe; None without
        any.
        """
        return next(
            (
                level
                for level in levels
                if self.safe([replace(environment, active_damping_ns_per_m=level)])[0]
            ),
            None,
        )

    def allowed(self, environment: Environment, limits: EnvironmentLimits) -> Ranges:
        """Return the allowed range of each of K, B, M with the others unchanged, within `limits`.

        It is the interval around the value if that is safe, otherwise the nearest safe interval, or
        None. The ends are safe, and accurate to a thousandth of a step of the grid.
        """
        points = [np.array(point) for point in environment.points()]
        cases = list(product(points, self.conditions(environment)))

        def safe(values: list[Floats], sure: bool) -> list[Flags]:
            test = self.basis.safe if sure else self.basis.hopeful
            flags = np.concatenate([np.ones(one.size, np.bool_) for one in values])
            for point, at in cases:
                moved = [_moved(point, axis, one, environment) for axis, one in enumerate(values)]
                flags &= test(np.concatenate(moved), at)
            return np.split(flags, np.cumsum([one.size for one in values])[:-1])

        (lowest_k, highest_k), *others = zip(limits.lowest, limits.highest, strict=True)
        ranges = [(max(lowest_k, 0.0), highest_k), *others]
        return dict(zip(AXES, intervals(safe, ranges, environment.free), strict=True))


def _moved(point: Floats, axis: int, values: Floats, environment: Environment) -> Floats:
    """Return the point (N, 3) with one of the environment's K, B, M at other values (N,)."""
    moved = np.tile(point, (len(values), 1))
    moved[:, axis] += values - environment.free[axis]
    return moved


def _passive(
    theorem: Theorem,
    filters: tuple[FilterParams, FilterParams],
    level_ns_per_m: float,
    delays_periods: tuple[float, ...],
) -> Ranges:
    """Return the passive range of K, B and M, each alone, within WIDEST."""
    velocity, acceleration = filters
    free = Environment(
        velocity_filter=velocity,
        acceleration_filter=acceleration,
        active_damping_ns_per_m=level_ns_per_m,
    )
    return SafeRegion(theorem, delays_periods, 0.0).allowed(free, WIDEST)


def passive_ranges(
    model: Model, filters: tuple[FilterParams, FilterParams], level_ns_per_m: float
) -> Ranges:
    """Return the passive ranges of `model` at that level of active damping, within WIDEST.

    They hold for every input, without friction. Measured or predicted ranges may be a few times
    larger, but not by the factor of a mistaken unit. `filters` are those of velocity and
    acceleration.
    """
    return _passive(Theorem(model), filters, level_ns_per_m, (model.delay_periods,))


def ranges_of(setup: GuardSetup) -> Ranges:
    """Return the ranges of the guard's device with the highest active damping that its
    file allows.
    """
    if setup.model is None:
        return {}
    ceiling = setup.active_damping_limit_ns_per_m
    return passive_ranges(model_of(setup.model), setup.environment.filters, ceiling)


def timing_cost(
    theorem: Theorem,
    filters: tuple[FilterParams, FilterParams],
    level_ns_per_m: float,
    delays_periods: tuple[float, ...],
) -> dict[str, Any]:
    """Return the largest K without any delay, and at all `delays_periods`, the longest first.

    B = M = 0, at that level of active damping. The theorem does not cover a varying delay;
    requiring passivity at both ends is a convention.
    """

    def stiffest(delays: tuple[float, ...]) -> float:
        ends = _passive(theorem, filters, level_ns_per_m, delays)["K"]
        return ends[1] if ends else 0.0

    stiffness = stiffest(delays_periods)
    ideal = stiffest((IDEAL_PERIODS,))
    return {
        "level_ns_per_m": level_ns_per_m,
        "stiffness_n_per_m": stiffness,
        "ideal_stiffness_n_per_m": ideal,
        "lost_share": 1.0 - stiffness / ideal if ideal else None,
    }


Asked = Callable[[list[Floats], bool], list[Flags]]  # values of several axes; full test or cheap


def intervals(
    safe: Asked, ranges: Sequence[tuple[float, float]], at: Sequence[float]
) -> list[list[float] | None]:
    """Return for each axis the connected interval around its value `at` in which `safe` holds.

    If the value is outside, it is the nearest interval inside the range of the axis. All axes are
    evaluated together. The first pass uses the cheaper necessary condition; ends and middle of its
    intervals are then verified. An axis that fails is searched again with the full test, so an axis
    whose own value is safe always has an interval.
    """
    grids = [_grid(low, high, one) for (low, high), one in zip(ranges, at, strict=True)]
    found: list[list[float] | None] = [None] * len(grids)
    for sure in (False, True):
        left = [axis for axis, interval in enumerate(found) if interval is None]
        flags = safe([grids[axis] if axis in left else NONE for axis in range(len(grids))], sure)
        runs = {axis: _run(grids[axis], flags[axis], at[axis]) for axis in left}
        runs = {axis: run for axis, run in runs.items() if run is not None}
        if not runs:
            continue
        ends = _refined(safe, grids, runs, sure)
        for axis, interval in (ends if sure else _made_sure(safe, ends, at)).items():
            found[axis] = interval
    return found


def _made_sure(
    safe: Asked, ends: dict[int, list[float]], at: Sequence[float]
) -> dict[int, list[float] | None]:
    """Return the verified parts of the intervals of some axes, whose own values are `at`."""
    checks = [_checks(ends[axis], own) if axis in ends else NONE for axis, own in enumerate(at)]
    flags = safe(checks, True)
    return {axis: _sure(checks[axis], flags[axis]) for axis in ends}


def _checks(ends: list[float], own: float) -> Floats:
    """Return the six values at which an interval is verified. They are its middle, each end and a
    point slightly inside each end, because an end is an estimate, and the value inside it that is
    nearest to the environment's own.
    """
    start, end = ends
    inside = start + (end - start) * np.array([0.0, _INSIDE, 0.5, 1.0 - _INSIDE, 1.0])
    return np.append(inside, min(max(own, start), end))


def _sure(values: Floats, flags: Flags) -> list[float] | None:
    """Return the verified part of an interval that was tested at six values; None without any."""
    first, near, middle, far, last, _ = flags.tolist()
    if not (middle and (first or near) and (far or last)):
        return None
    held = values[flags]
    return [float(held.min()), float(held.max())]


def _grid(low: float, high: float, at: float) -> Floats:
    distances = (high - low) * np.concatenate(([0.0], np.geomspace(1e-6, 1.0, _GRID)))
    values = np.concatenate((at - distances, at + distances, [0.0]))
    return np.asarray(np.unique(np.clip(values, low, high)))


def _run(values: Floats, flags: Flags, at: float) -> tuple[int, int] | None:
    """Return the first and last index of the run of true flags that is nearest to `at`."""
    held = np.flatnonzero(flags)
    if not held.size:
        return None
    nearest = int(held[np.argmin(np.abs(values[held] - at))])
    false = np.flatnonzero(~flags)
    first = int(false[false < nearest].max(initial=-1)) + 1
    last = int(false[false > nearest].min(initial=len(values))) - 1
    return first, last


def _refined(
    safe: Asked, grids: list[Floats], runs: Mapping[int, tuple[int, int] | None], sure: bool
) -> dict[int, list[float]]:
    inside = {}
    outside = {}
    for axis, run in runs.items():
        if run is not None:
            first, last = run
            values = grids[axis]
            inside[axis] = [values[first], values[last]]
            outside[axis] = [values[max(first - 1, 0)], values[min(last + 1, len(values) - 1)]]
    for _ in range(3):
        between = {
            axis: np.linspace(inside[axis], outside[axis], _FINER + 2)[1:-1] for axis in inside
        }
        asked = [between[axis].T.ravel() if axis in between else NONE for axis in range(len(grids))]
        flags = safe(asked, sure)
        for axis in inside:
            for end in (0, 1):
                held = flags[axis][end * _FINER : (end + 1) * _FINER]
                count = _FINER if held.all() else int(np.argmin(held))
                steps = [inside[axis][end], *between[axis][:, end], outside[axis][end]]
                inside[axis][end] = steps[count]
                outside[axis][end] = steps[count + 1]
    return {axis: [float(end) for end in ends] for axis, ends in inside.items()}


# --- verdict --------------------------------------------------------------------------------------

NOT_COVERED = ("contact switching", "varying delay")
NOTHING_KNOWN: dict[str, Any] = {
    "basis": "unknown",
    **Reading(None, None, None)._asdict(),
    "contact": None,
    "delay_periods": None,
    "allowed": {},
    "least_active_damping_ns_per_m": None,
}


class VerdictBuilder:
    """Verdicts on environments of the device of `setup`, as plain maps (docs/guard.md).

    `levels`: the cached levels of active damping, N s/m.
    """

    def __init__(self, setup: GuardSetup) -> None:
        self.setup = setup
        self.levels = cached_levels(
            setup.active_damping_limit_ns_per_m, setup.active_damping_ns_per_m
        )

    def of(
        self,
        region: SafeRegion | None,
        environment: Environment,
        policy: str,
        outcome: Outcome,
        why: Explanation,
        path: Sequence[Environment],
        given: Environment,
    ) -> dict[str, Any]:
        """Return the verdict on `environment`, judged along `path`; `given` is the end of the
        stages.
        """
        known = NOTHING_KNOWN if region is None else self._known(region, environment)
        if region is not None and known["least_active_damping_ns_per_m"] is None:
            no_level = (one for one in why.remedies if one.code != Remedy.MORE_DAMPING)
            why = Explanation(why.reasons, tuple(no_level))
        ends = self.setup.environment.workspace.stiffness_n_per_m > 0.0
        return {
            "safe": None if region is None else outcome is Outcome.SAFE,
            "policy": policy,
            **known,
            "clamped": outcome is Outcome.CLAMPED,
            "given": given.message(),
            "path_points": sum(len(one.points()) for one in path),
            "not_covered": [*NOT_COVERED, "soft ends of the workspace"] if ends else [*NOT_COVERED],
            **why.plain(outcome),
        }

    def _known(self, region: SafeRegion, environment: Environment) -> dict[str, Any]:
        contact = region.in_contact(environment)
        return {
            "basis": region.basis.name,
            **region.reading(environment)._asdict(),
            "contact": None if contact is None else contact._asdict(),
            "delay_periods": region.delays_periods[0],
            "allowed": region.allowed(environment, self.setup.limits),
            "least_active_damping_ns_per_m": region.least_level(environment, self.levels),
        }


def explain(region: SafeRegion, environment: Environment, safe: bool, way: str = "") -> Explanation:
    """Explain the safety of an environment, with values, units and, if it is unsafe, remedies.
    `way` is a prefix of the description of the environment.
    """
    where = f"{way}{environment_text(environment)}"
    if environment.stiffness_n_per_m < 0.0:
        text = f"{where}: K < 0 pushes away and is active at low frequencies"
        negative = Explanation.because(Reason.NEGATIVE_STIFFNESS, text)
        return negative.and_remedy(Remedy.POSITIVE_STIFFNESS, "ask for K >= 0")
    worst = region.worse(environment)
    side = "" if worst == region.reading(environment) else " in the wall"
    if worst.margin_ns_per_m is None:
        limits = f"the limits of {region.basis.name}"
        if safe:
            return Explanation.because(Reason.INSIDE, f"{where}: inside {limits}")
        outside = Explanation.because(Reason.OUTSIDE, f"{where}: not inside {limits}")
        return outside.and_remedy(Remedy.LESS, "ask for less")
    if safe:
        spare = (
            f"{worst.margin_ns_per_m:.3g} N s/m to spare{side}, least at {worst.worst_hz:.3g} Hz"
        )
        return Explanation.because(Reason.SPARE, f"{where}: {spare}")
    code, text = _shortage(region, worst, side)
    short = Explanation.because(code, f"{where}: {text}").and_remedy(Remedy.LESS, "ask for less")
    return short.and_remedy(Remedy.MORE_DAMPING, "for more active damping")


def _shortage(region: SafeRegion, worst: Reading, side: str) -> tuple[Reason, str]:
    margin = worst.margin_ns_per_m or 0.0
    rate_hz = region.basis.rate_hz
    if worst.radius is not None and worst.radius >= 1.0 and rate_hz is not None:
        return Reason.UNSTABLE, (
            f"unstable by itself{side}, its motion {doubling_text(worst.radius, rate_hz)},"
            f" worst near {worst.worst_hz:.3g} Hz"
        )
    return Reason.SHORT, (
        f"{region.spare_ns_per_m - margin:.3g} N s/m short{side} at {worst.worst_hz:.3g} Hz"
        f" ({region.basis.name})"
    )


def doubling_text(radius: float, rate_hz: float) -> str:
    """Return the growth of a motion that each tick multiplies by `radius` >= 1: `doubles
    in 40 ms`.
    """
    if radius <= 1.0:
        return "does not die out"
    seconds = log(2.0) / (log(radius) * rate_hz)
    return f"doubles in {1e3 * seconds:.3g} ms" if seconds < 1.0 else f"doubles in {seconds:.3g} s"


def environment_text(environment: Environment) -> str:
    """Describe an environment by its numbers."""
    k, b, m = environment.free
    level = environment.active_damping_ns_per_m
    return f"K = {k:g} N/m, B = {b:g} N s/m, M = {m:g} kg with {level:.4g} N s/m of active damping"


def hand_text(hand: Hand, hz: float, in_wall: bool) -> dict[str, Any]:
    """Describe a hand as its mass, or as its spring to the ground. Small tuned masses, which serve
    the spectral images of sampling, are left out.
    """
    where = f"at {hz:.3g} Hz" + (", in the wall" if in_wall else "")
    mass_kg = float(hand.mass_kg[0])
    if mass_kg > 0.0:
        return {"text": f"a mass of {1e3 * mass_kg:.3g} g, {where}", "mass_kg": mass_kg}
    # the sum of row 0 removes the joints to the other nodes and leaves the spring to the ground
    stiffness = float(hand.stiffness_n_per_m[0].sum())
    return {"text": f"a spring of {stiffness:.0f} N/m, {where}", "stiffness_n_per_m": stiffness}
