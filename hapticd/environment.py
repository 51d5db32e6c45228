"""What is rendered and damped: one value, and the one table of its fields.

A haptic display renders a virtual stiffness K on raw position, a virtual damping B and a virtual
mass M on filtered derivatives, and a unilateral wall (Weir, Colgate and Peshkin 2008, section 2).
The board adds active damping electrically (section 4). An `Environment` is all of that at one time.

It has two other forms: a row of doubles, by the slots of a command in the mailbox, and columns of a
telemetry record. FIELDS holds, for each number, its names in all three forms and in messages, its
unit and range, and whether it moves on a ramp and is judged. Every translation is derived from it.

Limitations: `workspace` is configured once and has no row in the table, for nothing changes it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

__all__ = [
    "FIELDS",
    "JUDGED",
    "SLOTS",
    "Environment",
    "EnvironmentField",
    "FilterParams",
    "Point",
    "WallParams",
    "WorkspaceParams",
]

Point = tuple[float, float, float]  # K [N/m], B [N s/m], M [kg]


@dataclass(frozen=True, slots=True)
class FilterParams:
    """Second-order low-pass: corner, damping ratio (0.7071 = Butterworth) and how it is made
    discrete.
    """

    frequency_hz: float
    damping_ratio: float = 0.7071067811865476
    mapping: str = "prewarped"  # "prewarped" | "bilinear" | "matched"


@dataclass(frozen=True, slots=True)
class WallParams:
    """Unilateral wall: pushes back towards the free side only. `side` +1: solid for x >
    position; -1: x < position; 0: none.
    """

    stiffness_n_per_m: float = 0.0
    virtual_damping_ns_per_m: float = 0.0
    position_m: float = 0.0
    side: int = 0


@dataclass(frozen=True, slots=True)
class WorkspaceParams:
    """Soft ends: springs that start at the ends of the usable travel."""

    lower_m: float = -1.0
    upper_m: float = 1.0
    stiffness_n_per_m: float = 0.0


class EnvironmentField(NamedTuple):
    """A number of an Environment, in each of its forms."""

    path: str  # of the attribute, parts joined by dots
    key: str  # in messages and at the shell: in the table before the dot, if there is one
    symbol: str  # in formulas; empty: none
    unit: str
    low: float  # least and most that any device may be asked for
    high: float
    slot: int  # place among the doubles of a command
    column: str = ""  # of a telemetry record; empty: no record holds it
    ramped: bool = True  # whether a change of it goes on a ramp
    judged: bool = True  # whether the guard judges a change of it
    # least and most until the signs of the device are verified: with the wrong one every spring
    # and damper drives
    unverified: tuple[float, float] | None = None


FIELDS: Final = (
    EnvironmentField(
        "stiffness_n_per_m", "K", "K", "N/m", -1e4, 1e5, 2, "stiffness_n_per_m",
        unverified=(0.0, 100.0),
    ),
    EnvironmentField(
        "virtual_damping_ns_per_m", "B", "B", "N s/m", -1e2, 1e3, 3, "virtual_damping_ns_per_m",
        unverified=(0.0, 2.0),
    ),
    EnvironmentField("mass_kg", "M", "M", "kg", -1.0, 10.0, 4, "mass_kg", unverified=(0.0, 0.0)),
    EnvironmentField(
        "velocity_filter.frequency_hz", "filters.velocity_hz", "", "Hz", 0.1, 1e5, 5, ramped=False
    ),
    EnvironmentField(
        "velocity_filter.damping_ratio", "filters.velocity_zeta", "", "1", 0.05, 10.0, 6,
        ramped=False,
    ),
    EnvironmentField(
        "acceleration_filter.frequency_hz", "filters.acceleration_hz", "", "Hz", 0.1, 1e5, 7,
        ramped=False,
    ),
    EnvironmentField(
        "acceleration_filter.damping_ratio", "filters.acceleration_zeta", "", "1", 0.05, 10.0, 8,
        ramped=False,
    ),
    EnvironmentField(
        "wall.stiffness_n_per_m", "wall.stiffness_n_per_m", "", "N/m", 0.0, 1e5, 9,
        "wall_stiffness_n_per_m", unverified=(0.0, 100.0),
    ),
    EnvironmentField(
        "wall.virtual_damping_ns_per_m", "wall.virtual_damping_ns_per_m", "", "N s/m", 0.0, 1e3,
        10, unverified=(0.0, 2.0),
    ),
    EnvironmentField(
        "wall.position_m", "wall.position_m", "", "m", -10.0, 10.0, 11, "wall_position_m"
    ),
    EnvironmentField("wall.side", "wall.side", "", "side", -1.0, 1.0, 12, "wall_side"),
    EnvironmentField(
        "active_damping_ns_per_m", "active_damping", "", "N s/m", 0.0, 1e3, 13,
        "active_damping_ns_per_m", ramped=False,  # its rate is limited instead
    ),
)  # fmt: skip
SLOTS: Final = {one.key: one.slot for one in FIELDS}
# the fields of a message that a verdict is about; a table (wall, filters) counts as one
JUDGED: Final = tuple(dict.fromkeys(one.key.partition(".")[0] for one in FIELDS if one.judged))


@dataclass(frozen=True, slots=True)
class Environment:
    """What is rendered and damped at one time."""

    stiffness_n_per_m: float = 0.0
    virtual_damping_ns_per_m: float = 0.0
    mass_kg: float = 0.0
    velocity_filter: FilterParams = FilterParams(100.0)
    acceleration_filter: FilterParams = FilterParams(72.0)
    wall: WallParams = WallParams()
    workspace: WorkspaceParams = WorkspaceParams()
    active_damping_ns_per_m: float = 0.0

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

    @property
    def filters(self) -> tuple[FilterParams, FilterParams]:
        """Those of velocity and acceleration."""
        return self.velocity_filter, self.acceleration_filter

    @property
    def empty(self) -> bool:
        """Whether it makes no force: K, B, M and the wall are 0."""
        wall = self.wall.stiffness_n_per_m, self.wall.virtual_damping_ns_per_m
        return not any((*self.free, *wall))

    def points(self) -> list[Point]:
        """All (K, B, M) that it is."""
        return [self.free] if self.contact is None else [self.free, self.contact]

    def scaled(self, share: float) -> "Environment":
        """The same with all its forces times `share`, as the gain of an enable has it."""
        weaker = replace(
            self.wall,
            stiffness_n_per_m=share * self.wall.stiffness_n_per_m,
            virtual_damping_ns_per_m=share * self.wall.virtual_damping_ns_per_m,
        )
        return replace(self.with_free([share * value for value in self.free]), wall=weaker)

    def with_free(self, free: Sequence[float]) -> "Environment":
        """The same with another K, B, M."""
        stiffness, virtual_damping, mass = (float(value) for value in free)
        return replace(
            self,
            stiffness_n_per_m=stiffness,
            virtual_damping_ns_per_m=virtual_damping,
            mass_kg=mass,
        )

    def with_values(self, given: Mapping[str, Any]) -> "Environment":
        """The same with the values of `given`, by path. A side becomes an int again."""
        tables: dict[str, dict[str, Any]] = {}
        for path, value in given.items():
            table, _, leaf = path.rpartition(".")
            kind = int if leaf == "side" else float
            tables.setdefault(table, {})[leaf] = kind(value)
        own = tables.pop("", {})
        parts = {name: replace(getattr(self, name), **part) for name, part in tables.items()}
        return replace(self, **own, **parts)

    # --- as a message -----------------------------------------------------------------------------

    def message(self) -> dict[str, Any]:
        """Its fields by their keys, nested as a request `set` has them."""
        found: dict[str, Any] = {}
        for one in FIELDS:
            table, _, leaf = one.key.rpartition(".")
            inside = found.setdefault(table, {}) if table else found
            inside[leaf] = _value(self, one.path)
        return found

    def changed(self, change: Mapping[str, Any]) -> "Environment":
        """The same with the fields of a request; other keys of `change` are ignored."""
        given = {
            one.path: inside[leaf]
            for one in FIELDS
            for table, _, leaf in (one.key.rpartition("."),)
            if leaf in (inside := change.get(table) or {} if table else change)
        }
        return self.with_values(given)

    def fields(self, change: Mapping[str, Any]) -> dict[str, Any]:
        """The fields that `change` names, with the values of this environment."""
        whole = self.message()
        return {
            name: (
                {leaf: whole[name][leaf] for leaf in value}
                if isinstance(value, Mapping)
                else whole[name]
            )
            for name, value in change.items()
            if name in whole
        }

    # --- as a row of doubles ----------------------------------------------------------------------

    def row(self) -> dict[int, float]:
        """Its numbers by the slots of a command."""
        return {one.slot: float(_value(self, one.path)) for one in FIELDS}

    def from_row(self, row: Sequence[float]) -> "Environment":
        """The same with the numbers of a whole `row`, as a command has it."""
        return self.with_values({one.path: row[one.slot] for one in FIELDS})


def _value(environment: Environment, path: str) -> Any:
    table, _, leaf = path.rpartition(".")
    return getattr(getattr(environment, table) if table else environment, leaf)
