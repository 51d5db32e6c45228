"""Plan a change: its stages in the order in which they may come, and the points they pass.

    what ramps        the line from what is in force now to what is asked; where an earlier change
                      is still under way too, the patch that both span, with its corners
    enable            the gain from 0 to 1, which scales every force
    active damping    the levels on the way, of those that are kept
    scheduled         this change comes after those before it, and those after it come after it

Active damping rises before K and B grow; K and B shrink before it falls. Each `Stage` waits for
what the board reports, or for the ramps of the stage before, never for a time. Other orders are
tried next: with what is under way brought to its end first, with what shrinks first, with what
grows first. A longer ramp goes through the same points, so none is asked for.

Where it is not known what comes first, a scheduled change or the end of the ramps before it, all
corners of what may then act have to be safe (`mixture`).

Limitations: a parameter that moves without being asked.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product, takewhile
from typing import Any, NamedTuple

import numpy as np

from hapticd.core.environment import Environment
from hapticd.guard.environments import AXES, apply_change, corner_mixtures, interpolate, kept_level

POINTS = 20  # of a whole way


class Stage(NamedTuple):
    """One command of a change, and what it waits for."""

    change: dict[str, Any]  # fields as in `set`, absolute values
    active_damping_at_least: float | None = None  # N s/m that the board has to report before
    after_ramps: bool = False  # ramps before it must have ended

    def plain(self) -> dict[str, Any]:
        """As it is sent."""
        return self._asdict()


class Segment(NamedTuple):
    """A part of a way: from what is in force, with what is still under way, to what is asked."""

    start: Environment  # in force
    under_way: Environment  # where what is on its way would end
    end: Environment
    gain: bool = False  # the gain goes from 0 to 1 at its end


@dataclass(frozen=True, eq=False)
class Plan:
    """Stages with the way that they take."""

    stages: list[Stage]
    segments: list[Segment]
    end: Environment


class Request(NamedTuple):
    """What is asked for, and where it starts from."""

    now: Environment  # in force, with the damping in effect
    target: Environment  # where what is under way ends
    wanted: Environment  # where this change leads
    change: dict[str, Any]  # its fields
    passed: list[Environment]  # in force at first, and where each change scheduled before it starts
    after: list[dict[str, Any]]  # scheduled later
    enable: bool
    moving: bool  # the environment is felt, or will be
    levels: tuple[float, ...]  # of damping that are kept
    count_ns_per_m: float  # of the damping DAC


class TransitionPlanner:
    """The ways to what `request` asks for, in the order in which they are tried."""

    def __init__(self, request: Request) -> None:
        self.request = request

    def plans(self) -> list[Plan]:
        """Each with its stages; the first is how it is done where nobody asks for safety."""
        wanted = self.request.wanted
        if not self.request.moving:
            whole = Stage(wanted.fields(self.request.change))
            return [Plan([whole], [Segment(wanted, wanted, wanted)], wanted)]
        if self.request.enable:
            return [self._enabling(False), self._enabling(True)]
        return [self.plan(stages) for stages in self._orders()]

    def plan(self, stages: list[Stage]) -> Plan:
        """The way that these stages take, from what is in force."""
        now = self.request.now
        target = self.request.target
        segments = []
        for stage in stages:
            if stage.active_damping_at_least is not None:
                now = replace(now, active_damping_ns_per_m=target.active_damping_ns_per_m)
            if stage.after_ramps:
                now = replace(target, active_damping_ns_per_m=now.active_damping_ns_per_m)
            end = apply_change(target, stage.change)
            segments.append(Segment(now, target, end))
            target = end
        return Plan(stages, segments, target)

    def path(self, plan: Plan) -> list[Environment]:
        """At most POINTS points of the way of `plan`, and of what is scheduled after it; each
        part has its end among them. None at all where they would be more.
        """
        segments = [*plan.segments, *self._later(plan.end)]
        size = max(
            len(one.points()) for segment in segments for one in (segment.start, segment.end)
        )
        room = POINTS // size
        more = room % len(segments)
        counts = [room // len(segments) + (place < more) for place in range(len(segments))]
        parts = [
            sampled_segment(segment, count, self.request.levels)
            for segment, count in zip(segments, counts, strict=True)
        ]
        return [environment for part in parts for environment in part] if all(parts) else []

    def mixture(self, plan: Plan) -> list[Environment]:
        """Corners of what may act where the order in time is not known: with changes that are
        scheduled, whose ramps and damping may still be under way when the next one comes, and
        at an enable while something is on its way.
        """
        request = self.request
        later = [segment.end for segment in self._later(plan.end)]
        known = not later and len(request.passed) == 1
        if known and not request.enable:
            return self._overlapping(plan)
        environments = [*request.passed, request.target, plan.end, *later]
        if plan.stages[-1].active_damping_at_least is not None:
            # nothing is felt before the damping that is asked for is in effect
            here = replace(
                request.passed[0], active_damping_ns_per_m=plan.end.active_damping_ns_per_m
            )
            environments[0] = here if request.enable else environments[0]
        rendered = {replace(one, active_damping_ns_per_m=0.0) for one in environments}
        return corner_mixtures(environments) if len(rendered) > 1 else []

    def _overlapping(self, plan: Plan) -> list[Environment]:
        """The same where two parameters or more are under way, each on a ramp of its own, until a
        stage waits for their ends.
        """
        pairs = zip(_numbers(self.request.now), _numbers(self.request.target), strict=True)
        if not self.request.moving or sum(start != end for start, end in pairs) < 2:
            return []
        together = takewhile(
            lambda one: not one[0].after_ramps, zip(plan.stages, plan.segments, strict=True)
        )
        corners = [
            corner_mixtures([segment.start, segment.under_way, segment.end])
            for _, segment in together
        ]
        return [environment for part in corners for environment in part]

    def _later(self, start: Environment) -> list[Segment]:
        segments = []
        for change in self.request.after:
            end = apply_change(start, change)
            segments.append(Segment(start, start, end))
            start = end
        return segments

    def _orders(self) -> list[list[Stage]]:
        change = self.request.change
        wanted = self.request.wanted
        here = self.request.target.active_damping_ns_per_m
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
        whole = [_with(stages, damping) for stages in orders]
        if self.request.now.active_damping_ns_per_m >= here:
            return whole
        return whole + [_waiting(stages, self._reported(here)) for stages in whole]

    def _environment_orders(self, rest: dict[str, Any]) -> list[list[Stage]]:
        """At once, after what is under way, and what shrinks and what grows one after the other."""
        orders = [[Stage(rest)], [Stage(rest, after_ramps=True)]]
        new = dict(zip(AXES, self.request.wanted.free, strict=True))
        old = dict(zip(AXES, self.request.target.free, strict=True))
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
        """What the board reports at least when it has that level: a count less."""
        return max(0.0, level - self.request.count_ns_per_m)

    def _enabling(self, waits: bool) -> Plan:
        """Force comes on at once, or once the damping that is asked for is in effect."""
        end = self.request.wanted
        change = end.fields(self.request.change)
        if not waits:
            start = replace(end, active_damping_ns_per_m=self.request.now.active_damping_ns_per_m)
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


def _with(stages: list[Stage], fields: dict[str, Any]) -> list[Stage]:
    return [stages[0]._replace(change=stages[0].change | fields), *stages[1:]]


def moving_groups(segment: Segment) -> int:
    """How many things move by themselves: what is asked, what is under way, the damping."""
    asked, under_way = _parts(segment)
    return (
        asked
        + under_way
        + (segment.start.active_damping_ns_per_m != segment.end.active_damping_ns_per_m)
    )


def _parts(segment: Segment) -> tuple[bool, bool]:
    """Whether what was asked moves the environment, and whether something else is under way."""
    asked = (
        replace(segment.end, active_damping_ns_per_m=segment.under_way.active_damping_ns_per_m)
        != segment.under_way
    )
    left = any(
        start != end and before == end
        for start, before, end in zip(
            _numbers(segment.start), _numbers(segment.under_way), _numbers(segment.end), strict=True
        )
    )
    return asked or segment.gain, left


def _numbers(environment: Environment) -> tuple[float, ...]:
    wall = environment.wall
    return (*environment.free, wall.stiffness_n_per_m, wall.virtual_damping_ns_per_m, wall.side)


def sampled_segment(
    segment: Segment, count: int, levels: Sequence[float] = ()
) -> list[Environment]:
    """At most `count` environments of a segment, its end the last: the line if one thing moves, a
    grid with all corners if several do. None if that takes more than `count`.
    """
    if count < 1:
        return []
    if segment.gain:
        return _gained(segment, count)
    moving = moving_groups(segment)
    if moving <= 1:
        # filters and the side of a wall change at once, while everything else is where it was
        first = 0.0 if _jumps(segment) and count > 1 else 1.0 / count
        line = np.linspace(first, 1.0, count).tolist()
        return [interpolate(segment.start, segment.end, share, levels) for share in line]
    side = int(count ** (1.0 / moving) + 1e-9)
    if side < 2:
        return []
    shares = np.linspace(0.0, 1.0, side).tolist()
    still = [1.0]
    asked, left = _parts(segment)
    damped = segment.start.active_damping_ns_per_m != segment.end.active_damping_ns_per_m
    grid = product(
        shares if asked else still, shares if left else still, shares if damped else still
    )
    return [_patch(segment, *place, levels) for place in grid]


def _jumps(segment: Segment) -> bool:
    """Whether something of the environment does not ramp."""
    sides = segment.start.wall.side, segment.end.wall.side
    return sides[0] != sides[1] or segment.start.filters != segment.end.filters


def _gained(segment: Segment, count: int) -> list[Environment]:
    """The gain from 0 to 1. Damping that is still on its way does not count before it is there."""
    if count < 3:
        return []
    here = replace(segment.end, active_damping_ns_per_m=segment.start.active_damping_ns_per_m)
    rising = [here.scaled((place + 1) / (count - 1)) for place in range(count - 1)]
    return [*rising, segment.end]


def _patch(
    segment: Segment, asked: float, left: float, level: float, levels: Sequence[float]
) -> Environment:
    """A segment's environment with what was asked, what was under way and active damping at shares
    of their own.
    """
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
