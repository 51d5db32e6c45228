"""What lies between two environments, and what may act while one goes over into the other.

An environment is (K, B, M) in free space and (K + K_wall, B + B_wall, M) in the wall; whatever is
said of it has to hold for both.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import isfinite
from typing import Any

from hapticd.core.environment import Environment, flat
from hapticd.core.errors import AnalysisError

AXES = ("K", "B", "M")


def from_message(plain: Mapping[str, Any], rendered: Environment) -> Environment:
    """The environment in the fields of a message, its filters made discrete as those of `rendered`;
    what the message leaves out is 0. AnalysisError for a number that is not finite.
    """
    velocity, acceleration = rendered.filters
    nothing = Environment(velocity_filter=velocity, acceleration_filter=acceleration)
    return apply_change(nothing, plain)


def apply_change(environment: Environment, change: Mapping[str, Any]) -> Environment:
    """`environment` with the fields of a request. AnalysisError for a number not finite."""
    for name, value in flat(change):
        if isinstance(value, float) and not isfinite(value):
            raise AnalysisError(f"{name} = {value}: the guard judges finite numbers only")
    return environment.changed(change)


def interpolate(
    one: Environment, other: Environment, share: float, levels: Sequence[float] = ()
) -> Environment:
    """The environment a share of the way from one to the other. Filters, and side and place of a
    wall, are those of the other; a level strictly between is one of `levels`, if any is. A wall
    that is taken away acts until its side has come to 0, with no more than the larger of both
    strengths.
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
    """The level a share of the way: one that is kept, not beyond that share; or the start."""
    if share >= 1.0 or start == end:
        return end
    exact = start + share * (end - start)
    inside = [level for level in levels if min(start, exact) <= level <= max(start, exact)]
    return min(inside, key=lambda level: abs(level - exact), default=start)


def corner_mixtures(environments: Sequence[Environment]) -> list[Environment]:
    """Corners of all that may act while each parameter is anywhere between those of them:
    least and most of K, B, M and level, with the strongest wall if one of them has any.
    """
    places = [one.free for one in environments]
    ranges = [sorted({min(axis), max(axis)}) for axis in zip(*places, strict=True)]
    levels = [one.active_damping_ns_per_m for one in environments]
    sides = [one.wall.side for one in environments if one.wall.side != 0]
    wall = replace(
        environments[-1].wall,
        stiffness_n_per_m=max(one.wall.stiffness_n_per_m for one in environments),
        virtual_damping_ns_per_m=max(one.wall.virtual_damping_ns_per_m for one in environments),
        side=sides[0] if sides else 0,
    )
    filters = {one.filters: one for one in environments}
    return [
        replace(one.with_free(free), wall=wall, active_damping_ns_per_m=level)
        for free in product(*ranges)
        for one in filters.values()
        for level in sorted({min(levels), max(levels)})
    ]
