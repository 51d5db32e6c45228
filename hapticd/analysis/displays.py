"""Displays: what is rendered and damped at one time, as a request names it, and what lies between
two of them.

A display is K, B, M with a wall, two filters and a level of active damping. It is two environments,
(K, B, M) in free space and (K + K_wall, B + B_wall, M) in the wall; whatever is said of a display
has to hold for both.

What would break it: a field of `set` that is missing here; it would change without being judged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import isfinite
from typing import Any, NamedTuple

from hapticd.errors import AnalysisError
from hapticd.params import EnvironmentParams, FilterParams, WallParams

Point = tuple[float, float, float]
AXES = ("K", "B", "M")


class Display(NamedTuple):
    """What is rendered and damped at one time."""

    stiffness_n_per_m: float
    virtual_damping_ns_per_m: float  # virtual damping B
    mass_kg: float
    wall: WallParams
    filters: tuple[FilterParams, FilterParams]  # of velocity and acceleration
    active_damping_ns_per_m: float  # level of active damping

    @property
    def free(self) -> Point:
        """K, B, M outside the wall."""
        return self.stiffness_n_per_m, self.virtual_damping_ns_per_m, self.mass_kg

    @property
    def contact(self) -> Point | None:
        """K, B, M in the wall; None without one."""
        if self.wall.side == 0:
            return None
        return (
            self.stiffness_n_per_m + self.wall.stiffness_n_per_m,
            self.virtual_damping_ns_per_m + self.wall.virtual_damping_ns_per_m,
            self.mass_kg,
        )

    def points(self) -> list[Point]:
        """All environments that it is."""
        return [self.free] if self.contact is None else [self.free, self.contact]

    def with_free(self, free: Point) -> "Display":
        """The display with another K, B, M."""
        stiffness, damping, mass = (float(value) for value in free)
        return self._replace(
            stiffness_n_per_m=stiffness, virtual_damping_ns_per_m=damping, mass_kg=mass
        )

    def scaled(self, share: float) -> "Display":
        """The display with all its forces times `share`, as the gain of an enable has it."""
        wall = replace(
            self.wall,
            stiffness_n_per_m=share * self.wall.stiffness_n_per_m,
            virtual_damping_ns_per_m=share * self.wall.virtual_damping_ns_per_m,
        )
        stiffness, damping, mass = self.free
        return self.with_free((share * stiffness, share * damping, share * mass))._replace(
            wall=wall
        )


def display_of(plain: Mapping[str, Any], rendered: EnvironmentParams) -> Display:
    """The display of these fields, its filters made discrete as `rendered` has them.

    AnalysisError for a number that is not finite.
    """
    filters = rendered.velocity_filter, rendered.acceleration_filter
    return changed(Display(0.0, 0.0, 0.0, WallParams(), filters, 0.0), plain)


def changed(display: Display, change: Mapping[str, Any]) -> Display:
    """The display with the fields of a `set`: K, B, M, parts of wall and filters, damping.

    AnalysisError for a number that is not finite.
    """
    _require_finite(change)
    stiffness, damping, mass = (
        float(change.get(name, value)) for name, value in zip("KBM", display.free, strict=True)
    )
    wall = replace(display.wall, **dict(change.get("wall") or {}))
    filters = change.get("filters") or {}
    first, second = (
        replace(
            one,
            frequency_hz=filters.get(f"{name}_hz", one.frequency_hz),
            damping_ratio=filters.get(f"{name}_zeta", one.damping_ratio),
        )
        for name, one in zip(("velocity", "acceleration"), display.filters, strict=True)
    )
    level = float(change.get("active_damping", display.active_damping_ns_per_m))
    return Display(stiffness, damping, mass, wall, (first, second), level)


def _require_finite(table: Mapping[str, Any], where: str = "") -> None:
    for name, value in table.items():
        if isinstance(value, Mapping):
            _require_finite(value, f"{where}{name}.")
        elif isinstance(value, float) and not isfinite(value):
            raise AnalysisError(f"{where}{name} = {value}: the guard judges finite numbers only")


def plain_of(display: Display) -> dict[str, Any]:
    """The fields of a display, as they are sent."""
    first, second = display.filters
    wall = display.wall
    stiffness, damping, mass = display.free
    return {
        "K": stiffness,
        "B": damping,
        "M": mass,
        "wall": {
            "stiffness_n_per_m": wall.stiffness_n_per_m,
            "virtual_damping_ns_per_m": wall.virtual_damping_ns_per_m,
            "position_m": wall.position_m,
            "side": wall.side,
        },
        "filters": {
            "velocity_hz": first.frequency_hz,
            "velocity_zeta": first.damping_ratio,
            "acceleration_hz": second.frequency_hz,
            "acceleration_zeta": second.damping_ratio,
        },
        "active_damping": display.active_damping_ns_per_m,
    }


def fields_of(change: Mapping[str, Any], display: Display) -> dict[str, Any]:
    """The fields that `change` names, with the values of `display`."""
    whole = plain_of(display)
    return {
        name: (
            {inner: whole[name][inner] for inner in value}
            if isinstance(value, Mapping)
            else whole[name]
        )
        for name, value in change.items()
        if name in whole
    }


def environment_of(display: Display, other: Display) -> dict[str, Any]:
    """The fields of its environment that may differ from those of `other`."""
    whole = plain_of(display)
    if other.wall.side == 0:
        return {name: whole[name] for name in "KBM"}
    return {name: whole[name] for name in ("K", "B", "M", "wall")}


def between(one: Display, other: Display, share: float, levels: Sequence[float] = ()) -> Display:
    """The display a share of the way from one to the other. Filters, and side and place of a
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
    stiffness, damping, mass = (part(*pair) for pair in zip(one.free, other.free, strict=True))
    return Display(stiffness, damping, mass, wall, other.filters, level)


def kept_level(start: float, end: float, share: float, levels: Sequence[float]) -> float:
    """The level a share of the way: one that is kept, not beyond that share; or the start."""
    if share >= 1.0 or start == end:
        return end
    exact = start + share * (end - start)
    inside = [level for level in levels if min(start, exact) <= level <= max(start, exact)]
    return min(inside, key=lambda level: abs(level - exact), default=start)


def mixed(displays: Sequence[Display]) -> list[Display]:
    """Corners of all that may act while each parameter is anywhere between those of `displays`:
    least and most of K, B, M and level, with the strongest wall if one of them has any.
    """
    places = [one.free for one in displays]
    ranges = [sorted({min(axis), max(axis)}) for axis in zip(*places, strict=True)]
    levels = [one.active_damping_ns_per_m for one in displays]
    sides = [one.wall.side for one in displays if one.wall.side != 0]
    wall = replace(
        displays[-1].wall,
        stiffness_n_per_m=max(one.wall.stiffness_n_per_m for one in displays),
        virtual_damping_ns_per_m=max(one.wall.virtual_damping_ns_per_m for one in displays),
        side=sides[0] if sides else 0,
    )
    filters = dict.fromkeys(one.filters for one in displays)
    return [
        Display(stiffness, damping, mass, wall, pair, level)
        for stiffness, damping, mass in product(*ranges)
        for pair in filters
        for level in sorted({min(levels), max(levels)})
    ]
