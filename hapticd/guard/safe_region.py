"""The safe region of a device: whether environments are safe, by how much, and how far each of K, B
and M may go; what a device renders of each alone, and what of K its delay costs.

An environment is safe if its K, B, M in free space and those in its wall are, by a basis (`bases`),
at each delay that is judged. How far K, B or M may go is looked for on a grid that gets
finer towards the environment's own value, and then between its last two points at either end.

Limitations: a device that renders nothing of one axis alone and much of it beside another; a delay
that changes from tick to tick; or a hand that makes and breaks contact with the wall in step with
its motion: each side is judged for itself, and neither is covered.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from hapticd.core.arrays import Flags, Floats
from hapticd.core.environment import Environment, FilterParams, Point
from hapticd.core.params import EnvironmentLimits, GuardSetup
from hapticd.guard.bases import Basis, Conditions, Reading, Theorem, model_of
from hapticd.guard.transition_planner import AXES
from hapticd.mailbox.environment_limits import WIDEST
from hapticd.model.model import Model

__all__ = ["passive_ranges", "ranges_of"]

_GRID = 40  # distances at which an axis is looked at, on either side
_FINER = 9  # values between the last that holds and the first that does not, three times
_INSIDE = 1e-3  # of an interval: as far inside of its ends as may be needed to be sure
NONE = np.zeros(0)
IDEAL_PERIODS = 0.0  # a force that acts at its sample: of the delay, the hold alone is left

Ranges = dict[str, list[float] | None]  # of K, B and M, from and to; None: nothing is passive


@dataclass(frozen=True)
class SafeRegion:
    """Displays judged by one basis, with one margin asked for, at one delay or at two: more delay
    makes a negative virtual mass easier, so the longest alone is not the worst.
    """

    basis: Basis
    delays_periods: tuple[float, ...]  # the longest first
    spare_ns_per_m: float

    def conditions(self, environment: Environment) -> list[Conditions]:
        """Those of one environment, by delay."""
        return [
            Conditions(
                environment.active_damping_ns_per_m, environment.filters, delay, self.spare_ns_per_m
            )
            for delay in dict.fromkeys(self.delays_periods)
        ]

    def safe(self, environments: Sequence[Environment]) -> list[bool]:
        """Whether each is safe, in free space and in contact."""
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
        """Whether a way is safe; one without points is not known to be."""
        return bool(path) and all(self.safe(path))

    def reading(self, environment: Environment) -> Reading:
        """How safe it is in free space."""
        return self._read(environment.free, environment)

    def in_contact(self, environment: Environment) -> Reading | None:
        """How safe it is in its wall; None without one."""
        point = environment.contact
        return None if point is None else self._read(point, environment)

    def _read(self, point: Point, environment: Environment) -> Reading:
        found = [self.basis.reading(point, at) for at in self.conditions(environment)]
        known = [one for one in found if one.margin_ns_per_m is not None]
        return min(known, key=lambda one: one.margin_ns_per_m or 0.0) if known else found[0]

    def worse(self, environment: Environment) -> Reading:
        """The reading of free space or contact, whichever has less margin."""
        free = self.reading(environment)
        contact = self.in_contact(environment)
        if contact is None or contact.margin_ns_per_m is None or free.margin_ns_per_m is None:
            return free
        return contact if contact.margin_ns_per_m < free.margin_ns_per_m else free

    def least_level(self, environment: Environment, levels: Sequence[float]) -> float | None:
        """The least of `levels` (rising) at which it is safe; None for none."""
        return next(
            (
                level
                for level in levels
                if self.safe([replace(environment, active_damping_ns_per_m=level)])[0]
            ),
            None,
        )

    def allowed(self, environment: Environment, limits: EnvironmentLimits) -> Ranges:
        """How far each of K, B, M may go with the others as they are, within `limits`: the interval
        round its value if that is safe, else the nearest that is, None for none.

        Ends are safe themselves, and lie within a thousandth of a step of the grid.
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
    """The point (N, 3) with one of the environment's K, B, M at other values (N,)."""
    moved = np.tile(point, (len(values), 1))
    moved[:, axis] += values - environment.free[axis]
    return moved


def _passive(
    theorem: Theorem,
    filters: tuple[FilterParams, FilterParams],
    level_ns_per_m: float,
    delays_periods: tuple[float, ...],
) -> Ranges:
    """What is passive of K, B and M, each alone, within WIDEST."""
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
    """What `model` renders passively at that level of active damping, within WIDEST: for every
    input and without friction. What is measured or predicted may reach further by a few times, not
    by the factor of a mistaken unit.

    `filters` are those of velocity and acceleration.
    """
    return _passive(Theorem(model), filters, level_ns_per_m, (model.delay_periods,))


def ranges_of(setup: GuardSetup) -> Ranges:
    """Those of the guard's device with the most active damping that its file allows."""
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
    """The largest K with B = M = 0 at that level of active damping and at all `delays_periods`, the
    longest first, beside the largest K without any delay.

    A delay that varies is outside the theorem: that both ends are passive is a convention.
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


Asked = Callable[[list[Floats], bool], list[Flags]]  # values of several axes; for sure, or not yet


def intervals(
    safe: Asked, ranges: Sequence[tuple[float, float]], at: Sequence[float]
) -> list[list[float] | None]:
    """For each axis the connected interval round its value `at` in which `safe` holds, or the
    nearest one, inside its range. All axes are asked together.

    `safe` may first hope, where that is cheaper; ends and middle of what is found are then made
    sure of. An axis that fails there is looked at again with nothing hoped, so an axis whose own
    value is safe always has an interval.
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
    """What is sure of the intervals of some of the axes, which are at `at`."""
    checks = [_checks(ends[axis], own) if axis in ends else NONE for axis, own in enumerate(at)]
    flags = safe(checks, True)
    return {axis: _sure(checks[axis], flags[axis]) for axis in ends}


def _checks(ends: list[float], own: float) -> Floats:
    """Where an interval is made sure of: at its middle, at each end or a little inside, for an
    end is an estimate, and at the value inside that is the environment's own.
    """
    start, end = ends
    inside = start + (end - start) * np.array([0.0, _INSIDE, 0.5, 1.0 - _INSIDE, 1.0])
    return np.append(inside, min(max(own, start), end))


def _sure(values: Floats, flags: Flags) -> list[float] | None:
    """What is sure of an interval that was looked at in six places; None if nothing is."""
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
    """First and last place of the run of true flags that is nearest to `at`."""
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
    """Both ends of each run, nearer to where it stops."""
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
