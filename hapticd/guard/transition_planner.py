"""Plan a change: its stages in an admissible order, and the points that they pass.

    ramps             the line from the environment in force to the requested one; while an earlier
                      change is also in progress, the patch that both span, with its corners
    enable            the gain from 0 to 1, which scales every force
    active damping    the cached levels on the path
    scheduled         this change follows those scheduled before it, and precedes those after it

Active damping rises before K and B grow; K and B shrink before it falls. Each `Stage` waits for a
report of the board, or for the ramps of the stage before, never for a time. Other orders are tried
next: complete the changes in progress first, shrink first, grow first. A longer ramp passes the
same points, so none is tried.

The order of a scheduled change and of the end of the ramps before it may be unknown. Then all
corners of the possible environments must be safe (`mixture`).

An environment is (K, B, M) in free space and (K + K_wall, B + B_wall, M) in the wall; every
statement about it must hold for both.

No parameter may move without a request.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product, takewhile
from typing import Any, NamedTuple

import numpy as np

from hapticd.core.environment import Environment, WallParams

POINTS = 20  # of a whole path
AXES = ("K", "B", "M")


class Stage(NamedTuple):
    """One command of a change, and its condition."""

    change: dict[str, Any]  # fields as in `set`, absolute values
    active_damping_at_least: float | None = None  # N s/m that the board must report first
    after_ramps: bool = False  # earlier ramps must have ended


class Segment(NamedTuple):
    """A part of a path: from the environment in force, with changes in progress, to the requested
    one.
    """

    start: Environment  # in force
    under_way: Environment  # end of the changes in progress
    end: Environment
    gain: bool = False  # the gain goes from 0 to 1 at its end


@dataclass(frozen=True, eq=False)
class Plan:
    """Stages and the path that they take."""

    stages: list[Stage]
    segments: list[Segment]
    end: Environment


@dataclass(frozen=True)
class TransitionPlanner:
    """The requested change, its start, and the possible paths in the order in which they
    are tried.
    """

    now: Environment  # in force, with the damping in effect
    target: Environment  # end of the changes in progress
    passed: list[Environment]  # in force at first, then the start of each earlier scheduled change
    after: Sequence[Mapping[str, Any]]  # changes that are scheduled later
    enable: bool
    moving: bool  # the environment acts, or will act
    levels: tuple[float, ...]  # cached levels of damping
    count_ns_per_m: float  # of the damping DAC
    change: Mapping[str, Any]  # the requested fields
    wall_virtual_dampings: Sequence[float] = ()  # N s/m; other values that the wall may have

    @cached_property
    def wanted(self) -> Environment:
        """The end of the change."""
        return self.target.changed(self.change)

    def plans(self) -> list[Plan]:
        """Return the plans with their stages; the first is used if safety is not required."""
        wanted = self.wanted
        if not self.moving:
            whole = Stage(wanted.fields(self.change))
            return [Plan([whole], [Segment(wanted, wanted, wanted)], wanted)]
        if self.enable:
            return [self._enabling(False), self._enabling(True)]
        return [self.plan(stages) for stages in self._orders()]

    def plan(self, stages: list[Stage]) -> Plan:
        """Return the plan of these stages, from the environment in force."""
        now = self.now
        target = self.target
        segments = []
        for stage in stages:
            if stage.active_damping_at_least is not None:
                now = replace(now, active_damping_ns_per_m=target.active_damping_ns_per_m)
            if stage.after_ramps:
                now = replace(target, active_damping_ns_per_m=now.active_damping_ns_per_m)
            end = target.changed(stage.change)
            segments.append(Segment(now, target, end))
            target = end
        return Plan(stages, segments, target)

    def path(self, plan: Plan) -> list[Environment]:
        """Return at most POINTS points of the path of `plan` and of the changes scheduled after it.
        Each segment contributes its end. Return [] if more points would be needed.
        """
        segments = [*plan.segments, *self._later(plan.end)]
        size = max(
            len(one.points()) for segment in segments for one in (segment.start, segment.end)
        )
        room = POINTS // size
        more = room % len(segments)
        counts = [room // len(segments) + (place < more) for place in range(len(segments))]
        parts = [
            sampled_segment(segment, count, self.levels)
            for segment, count in zip(segments, counts, strict=True)
        ]
        return [environment for part in parts for environment in part] if all(parts) else []

    def mixture(self, plan: Plan) -> list[Environment]:
        """Return the corners of the environments that may act where the order in time is unknown.

        This applies to scheduled changes, whose ramps and damping may still be in progress when the
        next one starts. It also applies to an enable while a change is in progress.
        """
        later = [segment.end for segment in self._later(plan.end)]
        known = not later and len(self.passed) == 1
        if known and not self.enable:
            return self._overlapping(plan)
        environments = [*self.passed, self.target, plan.end, *later]
        if plan.stages[-1].active_damping_at_least is not None:
            # no force acts before the requested damping is in effect
            here = replace(self.passed[0], active_damping_ns_per_m=plan.end.active_damping_ns_per_m)
            environments[0] = here if self.enable else environments[0]
        environments += self._others(environments[0])
        rendered = {replace(one, active_damping_ns_per_m=0.0) for one in environments}
        return corner_mixtures(environments) if len(rendered) > 1 else []

    def _overlapping(self, plan: Plan) -> list[Environment]:
        """Return the corners while several parameters are in progress, each on its own ramp. They
        apply up to the first stage that waits for the ramps.
        """
        pairs = zip(_numbers(self.now), _numbers(self.target), strict=True)
        several = self.wall_virtual_dampings or sum(start != end for start, end in pairs) >= 2
        if not (self.moving and several):
            return []
        together = takewhile(
            lambda one: not one[0].after_ramps, zip(plan.stages, plan.segments, strict=True)
        )
        corners = [
            corner_mixtures(
                [segment.start, segment.under_way, segment.end, *self._others(segment.start)]
            )
            for _, segment in together
        ]
        return [environment for part in corners for environment in part]

    def _others(self, here: Environment) -> list[Environment]:
        """Return `here` with each other virtual damping that its wall may have."""
        return [
            replace(here, wall=replace(here.wall, virtual_damping_ns_per_m=value))
            for value in self.wall_virtual_dampings
        ]

    def _later(self, start: Environment) -> list[Segment]:
        segments = []
        for change in self.after:
            end = start.changed(change)
            segments.append(Segment(start, start, end))
            start = end
        return segments

    def _orders(self) -> list[list[Stage]]:
        change = self.change
        wanted = self.wanted
        here = self.target.active_damping_ns_per_m
        damping = (
            {"active_damping": wanted.active_damping_ns_per_m} if "active_damping" in change else {}
        )
        rest = {name: value for name, value in change.items() if name != "active_damping"}
        if not rest:
            return [[Stage(damping)], [Stage(damping, after_ramps=True)]]
        orders = self._environment_orders(wanted.fields(rest))
        if wanted.active_damping_ns_per_m > here:
            level = self._reported(wanted.active_damping_ns_per_m)
            return [[Stage(damping), *_waiting(stages, level)] for stages in orders]
        if wanted.active_damping_ns_per_m < here:
            return [[*stages, Stage(damping, after_ramps=True)] for stages in orders]
        whole = [
            [first._replace(change=first.change | damping), *others] for first, *others in orders
        ]
        if self.now.active_damping_ns_per_m >= here:
            return whole
        return whole + [_waiting(stages, self._reported(here)) for stages in whole]

    def _environment_orders(self, rest: dict[str, Any]) -> list[list[Stage]]:
        """Return the orders: at once, after changes in progress, and shrinking and growing values
        in turn.
        """
        orders = [[Stage(rest)], [Stage(rest, after_ramps=True)]]
        new = dict(zip(AXES, self.wanted.free, strict=True))
        old = dict(zip(AXES, self.target.free, strict=True))
        shrinking = {name for name in rest if name in new and abs(new[name]) < abs(old[name])}
        one = {name: value for name, value in rest.items() if name in shrinking}
        other = {name: value for name, value in rest.items() if name not in shrinking}
        if not one or not other:
            return orders
        return [
            *orders,
            [Stage(one), Stage(other, after_ramps=True)],
            [Stage(other), Stage(one, after_ramps=True)],
        ]

    def _reported(self, level: float) -> float:
        """Return the lowest value that the board reports at that level: one count less."""
        return max(0.0, level - self.count_ns_per_m)

    def _enabling(self, waits: bool) -> Plan:
        """Enable force at once, or once the requested damping is in effect."""
        end = self.wanted
        change = end.fields(self.change)
        if not waits:
            start = replace(end, active_damping_ns_per_m=self.now.active_damping_ns_per_m)
            return Plan([Stage(change)], [Segment(start, start, end, gain=True)], end)
        level = self._reported(end.active_damping_ns_per_m)
        stages = [Stage(change)] if change else []
        return Plan(
            [*stages, Stage({}, active_damping_at_least=level)],
            [Segment(end, end, end, gain=True)],
            end,
        )


def _waiting(stages: list[Stage], level: float) -> list[Stage]:
    return [stages[0]._replace(active_damping_at_least=level), *stages[1:]]


def moving_groups(segment: Segment) -> int:
    """Return how many groups move separately: the request, changes in progress, the damping."""
    return sum(_moving(segment))


def _moving(segment: Segment) -> tuple[bool, bool, bool]:
    """Return whether the request moves the environment, whether another change is in progress, and
    whether the damping moves.
    """
    start, under_way, end = segment[:3]
    level = under_way.active_damping_ns_per_m
    asked = segment.gain or replace(end, active_damping_ns_per_m=level) != under_way
    numbers = zip(_numbers(start), _numbers(under_way), _numbers(end), strict=True)
    left = any(first != last and before == last for first, before, last in numbers)
    return asked, left, start.active_damping_ns_per_m != end.active_damping_ns_per_m


def _numbers(environment: Environment) -> tuple[float, ...]:
    return (*environment.free, *_strength(environment.wall), environment.wall.side)


def _strength(wall: WallParams) -> tuple[float, float]:
    return wall.stiffness_n_per_m, wall.virtual_damping_ns_per_m


def sampled_segment(
    segment: Segment, count: int, levels: Sequence[float] = ()
) -> list[Environment]:
    """Return at most `count` environments of a segment, with its end last.

    They are a line if one group moves, a grid with all corners if several do. Return [] if that
    takes more than `count`.
    """
    if count < 1:
        return []
    if segment.gain:
        return _gained(segment, count)
    moving = _moving(segment)
    if sum(moving) <= 1:
        # filters and the side of a wall change at once, before anything else has moved
        here, end = segment.start, segment.end
        jumps = here.wall.side != end.wall.side or here.filters != end.filters
        first = 0.0 if jumps and count > 1 else 1.0 / count
        line = np.linspace(first, 1.0, count).tolist()
        return [interpolate(segment.start, segment.end, share, levels) for share in line]
    side = int(count ** (1.0 / sum(moving)) + 1e-9)
    if side < 2:
        return []
    shares = np.linspace(0.0, 1.0, side).tolist()
    grid = product(*(shares if moves else [1.0] for moves in moving))
    return [_patch(segment, place, levels) for place in grid]


def _gained(segment: Segment, count: int) -> list[Environment]:
    """Sample the gain from 0 to 1. A change of damping does not count before it is complete."""
    if count < 3:
        return []
    here = replace(segment.end, active_damping_ns_per_m=segment.start.active_damping_ns_per_m)
    return [*(here.scaled((place + 1) / (count - 1)) for place in range(count - 1)), segment.end]


def _patch(segment: Segment, shares: Sequence[float], levels: Sequence[float]) -> Environment:
    """Return the environment of a segment at separate shares of the request, of changes in progress
    and of the active damping.
    """
    asked, left, level = shares
    fast = interpolate(segment.start, segment.end, asked)
    slow = interpolate(segment.start, segment.end, left)
    still = [
        before == end
        for before, end in zip(_numbers(segment.under_way), _numbers(segment.end), strict=True)
    ]
    numbers = [
        s if own else f for own, s, f in zip(still, _numbers(slow), _numbers(fast), strict=True)
    ]
    wall = replace(
        segment.end.wall,
        stiffness_n_per_m=numbers[3],
        virtual_damping_ns_per_m=numbers[4],
        side=int(numbers[5]),
    )
    added = kept_level(
        segment.start.active_damping_ns_per_m, segment.end.active_damping_ns_per_m, level, levels
    )
    return replace(segment.end.with_free(numbers[:3]), wall=wall, active_damping_ns_per_m=added)


# --- environments, and interpolation between them -------------------------------------------------


def from_message(plain: Mapping[str, Any], rendered: Environment) -> Environment:
    """Return the environment in the fields of a message; omitted fields are 0. Its filters have the
    discretisation of `rendered`. ConfigError for a number that is not finite.
    """
    velocity, acceleration = rendered.filters
    nothing = Environment(velocity_filter=velocity, acceleration_filter=acceleration)
    return nothing.changed(plain)


def interpolate(
    one: Environment, other: Environment, share: float, levels: Sequence[float] = ()
) -> Environment:
    """Return the environment at a share of the way from `one` to `other`.

    Filters, and the side and position of a wall, are those of `other`. An intermediate level is one
    of `levels`, if any lies on the way. A wall that is being removed acts until its side has ramped
    to 0, with at most the larger of both strengths.
    """

    def part(start: float, end: float) -> float:
        return end if share >= 1.0 else start + share * (end - start)

    def most(start: float, end: float) -> float:
        return max(start, end)

    going = share < 1.0 and one.wall.side != 0 and other.wall.side == 0
    strength = most if going else part
    wall = replace(
        other.wall,
        stiffness_n_per_m=strength(one.wall.stiffness_n_per_m, other.wall.stiffness_n_per_m),
        virtual_damping_ns_per_m=strength(
            one.wall.virtual_damping_ns_per_m, other.wall.virtual_damping_ns_per_m
        ),
        side=one.wall.side if going else other.wall.side,
    )
    level = kept_level(one.active_damping_ns_per_m, other.active_damping_ns_per_m, share, levels)
    free = [part(*pair) for pair in zip(one.free, other.free, strict=True)]
    return replace(other.with_free(free), wall=wall, active_damping_ns_per_m=level)


def kept_level(start: float, end: float, share: float, levels: Sequence[float]) -> float:
    """Return the cached level at a share of the way, not beyond that share; otherwise the start."""
    if share >= 1.0 or start == end:
        return end
    exact = start + share * (end - start)
    inside = [level for level in levels if min(start, exact) <= level <= max(start, exact)]
    return min(inside, key=lambda level: abs(level - exact), default=start)


def corner_mixtures(environments: Sequence[Environment]) -> list[Environment]:
    """Return the corners of all environments with each parameter anywhere between those of
    `environments`.

    Their axes are K, B, M, the wall's stiffness and virtual damping, and the level of active
    damping.
    """
    places = [
        (*one.free, *_strength(one.wall), one.active_damping_ns_per_m) for one in environments
    ]
    ranges = [sorted({min(axis), max(axis)}) for axis in zip(*places, strict=True)]
    sides = [one.wall.side for one in environments if one.wall.side != 0]
    wall = replace(environments[-1].wall, side=sides[0] if sides else 0)
    filters = {one.filters: one for one in environments}
    return [
        replace(
            one.with_free(free),
            wall=replace(wall, stiffness_n_per_m=stiffness, virtual_damping_ns_per_m=damping),
            active_damping_ns_per_m=level,
        )
        for *free, stiffness, damping, level in product(*ranges)
        for one in filters.values()
    ]
