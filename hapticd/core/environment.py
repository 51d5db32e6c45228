"""The rendered impedance and the active damping as one value, and limits declared with a setting.

Environment (`Environment`). A haptic display renders a virtual stiffness K on raw position, and a
unilateral wall. A virtual damping B and a virtual mass M act on filtered derivatives. The board
adds active damping electrically (Weir, Colgate and Peshkin 2008, sections 2 and 4). An
`Environment` contains all of these at one time.

Fields (`EnvironmentField`). An environment has two other forms: a row of doubles, by the slots of a
command in the mailbox, and columns of a telemetry record. Each number is declared with its row of
the table FIELDS: its names in all three forms and in messages, its unit and range, and the effect
of a change. Every translation is derived from the table.

`workspace` is configured once and has no row in the table, because no command changes it.

Limits (`Constraints`). A setting declares its own: `rate_hz: Annotated[float, Constraints(ge=50)]`.

The parameters of one TOML table (`TableParams`) are declared once, in `core.params` or
`model.params`: fields are keys, defaults are those of the file, and attribute docstrings describe a
key in the JSON schema. `settings` passes these classes to pydantic, which calls their methods. No
code here imports pydantic, and the servo process runs without it.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from inspect import cleandoc
from math import isfinite
from typing import Annotated, Any, Final, NamedTuple

from hapticd.core.errors import ConfigError

__all__ = [
    "FIELDS",
    "FIRST_FURTHER_SLOT",
    "FURTHER",
    "JUDGED",
    "SLOTS",
    "STRENGTHS",
    "Constraints",
    "Environment",
    "FilterParams",
    "Microseconds",
    "NotNegative",
    "Point",
    "Positive",
    "ServoRateHz",
    "TableParams",
    "WallParams",
    "WorkspaceParams",
    "flat",
]


# --- limits ---------------------------------------------------------------------------------------


class Constraints:
    """Limits of a value, with pydantic's names: ge, gt, le, lt, min_length, strict."""

    def __init__(self, **constraints: Any) -> None:
        self._constraints = constraints

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> dict[str, Any]:
        return {**handler(source), **self._constraints}


class TableParams:
    """Base of parameters that correspond to one TOML table."""

    __slots__ = ()

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        schema = handler(source)
        # a strict schema would accept only instances; the fields stay strict
        handler.resolve_ref_schema(schema)["strict"] = False
        return schema

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: Any, handler: Any) -> Any:
        found = handler(schema)
        # pydantic 2.11 sets neither for a dataclass
        said = {"description": cleandoc(cls.__doc__ or ""), "additionalProperties": False}
        handler.resolve_ref_schema(found).update(said)
        return found


Positive = Annotated[float, Constraints(gt=0)]
NotNegative = Annotated[float, Constraints(ge=0)]
Duration = Annotated[float, Constraints(ge=0, le=60)]
ServoRateHz = Annotated[float, Constraints(ge=50, le=20_000)]
Microseconds = Annotated[float, Constraints(ge=0, le=1000)]


# --- the environment ------------------------------------------------------------------------------
Point = tuple[float, float, float]  # K [N/m], B [N s/m], M [kg]


@dataclass(frozen=True, slots=True)
class FilterParams:
    """Second-order low-pass: corner, damping ratio (0.7071 = Butterworth) and method of
    discretisation.
    """

    frequency_hz: float
    damping_ratio: float = 0.7071067811865476
    mapping: str = "prewarped"  # "prewarped" | "bilinear" | "matched"


@dataclass(frozen=True, slots=True)
class WallParams:
    """Unilateral wall: pushes back towards the free side only. `side` +1: solid for x > position;
    -1: x < position; 0: none.
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
    """One number of an Environment, in each of its forms."""

    key: str  # in messages and at the shell; the part before a dot is a table
    symbol: str  # in formulas; empty: none
    unit: str
    low: float  # range for any device
    high: float
    slot: int  # place among the doubles of a command
    column: str = ""  # of a telemetry record; empty: in no record
    meaning: str = ""  # in a few words, for schemas
    ramped: bool = True  # whether a change is ramped
    strength: bool = True  # whether a force is proportional to it
    power: int = 0  # n of a spring with the force value * x^n; 0: not a spring
    # range until the signs of the device are verified: with a wrong sign every spring and damper
    # drives the handle
    unverified: tuple[float, float] | None = None
    path: str = ""  # of the attribute, parts joined by dots; set in FIELDS


def _number(*row: Any, **more: Any) -> Any:
    """Declare an attribute that is a number with default 0, and its row."""
    return field(default=0.0, metadata={"": EnvironmentField(*row, **more)})


def _filter(name: str, slot: int) -> dict[str, EnvironmentField]:
    """Return the rows of a filter, with its corner in `slot` and its damping ratio in
    the next one.
    """
    fixed: dict[str, Any] = {"ramped": False, "strength": False}
    corner = f"corner of the {name} filter"
    ratio = f"damping ratio of the {name} filter"
    key = f"filters.{name}"
    return {
        "frequency_hz": EnvironmentField(
            f"{key}_hz", "", "Hz", 0.1, 1e5, slot, meaning=corner, **fixed
        ),
        "damping_ratio": EnvironmentField(
            f"{key}_zeta", "", "1", 0.05, 10.0, slot + 1, meaning=ratio, **fixed
        ),
    }


_WALL = {
    "stiffness_n_per_m": EnvironmentField(
        "wall.stiffness_n_per_m", "", "N/m", 0.0, 1e5, 9, "wall_stiffness_n_per_m",
        "stiffness of the wall", unverified=(0.0, 100.0),
    ),
    "virtual_damping_ns_per_m": EnvironmentField(
        "wall.virtual_damping_ns_per_m", "", "N s/m", 0.0, 1e3, 10,
        meaning="virtual damping of the wall", unverified=(0.0, 2.0),
    ),
    "position_m": EnvironmentField(
        "wall.position_m", "", "m", -10.0, 10.0, 11, "wall_position_m", "where it stands",
        strength=False,
    ),
    "side": EnvironmentField(
        "wall.side", "", "side", -1.0, 1.0, 12, "wall_side",
        "+1: solid beyond the position, -1: before it, 0: no wall", strength=False,
    ),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Environment:
    """Rendered impedance and active damping at one time."""

    stiffness_n_per_m: float = _number(
        "K", "K", "N/m", -1e4, 1e5, 2, "stiffness_n_per_m", "virtual stiffness", power=1,
        unverified=(0.0, 100.0),
    )  # fmt: skip
    virtual_damping_ns_per_m: float = _number(
        "B", "B", "N s/m", -1e2, 1e3, 3, "virtual_damping_ns_per_m", "virtual damping",
        unverified=(0.0, 2.0),
    )  # fmt: skip
    mass_kg: float = _number(
        "M", "M", "kg", -1.0, 10.0, 4, "mass_kg", "virtual mass", unverified=(0.0, 0.0)
    )
    velocity_filter: FilterParams = field(
        default=FilterParams(100.0), metadata=_filter("velocity", 5)
    )
    acceleration_filter: FilterParams = field(
        default=FilterParams(72.0), metadata=_filter("acceleration", 7)
    )
    wall: WallParams = field(default=WallParams(), metadata=_WALL)
    workspace: WorkspaceParams = WorkspaceParams()
    active_damping_ns_per_m: float = _number(
        "active_damping", "", "N s/m", 0.0, 1e3, 13, "active_damping_ns_per_m",
        "active damping; 0 switches it off and keeps the level",
        ramped=False, strength=False,  # its rate is limited instead
    )  # fmt: skip

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
        """The filters of velocity and acceleration."""
        return self.velocity_filter, self.acceleration_filter

    @property
    def empty(self) -> bool:
        """Whether it makes no force: all fields that scale a force are 0."""
        return not any(_value(self, one.path) for one in STRENGTHS)

    @property
    def further(self) -> tuple[float, ...]:
        """The further numbers of the law."""
        return tuple(_value(self, one.path) for one in FURTHER)

    def points(self) -> list[Point]:
        """Return all its (K, B, M): in free space and, if there is a wall, in contact."""
        return [self.free] if self.contact is None else [self.free, self.contact]

    def scaled(self, share: float) -> "Environment":
        """Return it with all forces times `share`, as by the gain of an enable."""
        return self.with_values({one.path: share * _value(self, one.path) for one in STRENGTHS})

    def with_free(self, free: Sequence[float]) -> "Environment":
        """Return it with another K, B, M."""
        stiffness, virtual_damping, mass = (float(value) for value in free)
        return replace(
            self,
            stiffness_n_per_m=stiffness,
            virtual_damping_ns_per_m=virtual_damping,
            mass_kg=mass,
        )

    def with_values(self, given: Mapping[str, Any]) -> "Environment":
        """Return it with the values of `given`, by path. A side becomes an int again."""
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
        """Return its fields by their keys, nested as in a request `set`."""
        return _nested((one.key, _value(self, one.path)) for one in FIELDS)

    def changed(self, change: Mapping[str, Any]) -> "Environment":
        """Return it with the fields of a request. ConfigError for an unknown field or a number that
        is not finite.
        """
        given = dict(flat(change))
        if wrong := [key for key, value in given.items() if not isfinite(value)]:
            raise ConfigError(f"{wrong[0]} = {given[wrong[0]]}: an environment has finite numbers")
        return self.with_values({_path(key): value for key, value in given.items()})

    def fields(self, change: Mapping[str, Any]) -> dict[str, Any]:
        """Return the fields in `change`, with the values of this environment. ConfigError for an
        unknown field.
        """
        return _nested((key, _value(self, _path(key))) for key, _ in flat(change))

    # --- as a row of doubles ----------------------------------------------------------------------

    def row(self) -> dict[int, float]:
        """Return its numbers by the slots of a command."""
        return {one.slot: float(_value(self, one.path)) for one in FIELDS}

    def with_slots(self, given: Mapping[int, float]) -> "Environment":
        """Return it with the numbers of `given`, by slot; slots that are not fields are ignored."""
        return self.with_values({one.path: given[one.slot] for one in FIELDS if one.slot in given})


def _value(environment: Environment, path: str) -> Any:
    table, _, leaf = path.rpartition(".")
    return getattr(getattr(environment, table) if table else environment, leaf)


def flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (dotted name, value) of every leaf of nested tables, as in messages."""
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _nested(values: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in values:
        table, _, leaf = key.rpartition(".")
        inside = found.setdefault(table, {}) if table else found
        inside[leaf] = value
    return found


def _path(key: str) -> str:
    if key not in _PATHS:
        known = ", ".join(_PATHS)
        raise ConfigError(f"{key}: no field of an environment; there are {known}")
    return _PATHS[key]


FIELDS: Final = tuple(
    row._replace(path=f"{one.name}.{leaf}" if leaf else one.name)
    for one in fields(Environment)
    for leaf, row in one.metadata.items()
)
SLOTS: Final = {one.key: one.slot for one in FIELDS}
_PATHS: Final[dict[str, str]] = {one.key: one.path for one in FIELDS}
# the fields of a message that the guard judges; a table (wall, filters) counts as one
JUDGED: Final = tuple(dict.fromkeys(one.key.partition(".")[0] for one in FIELDS))
STRENGTHS: Final = tuple(one for one in FIELDS if one.strength)
# Lower slots are taken. A field with a slot from here on is a further parameter: the law takes it
# after its own numbers. The guard, whose model is linear, cannot judge it unless it is 0.
FIRST_FURTHER_SLOT: Final = 27
FURTHER: Final = tuple(one for one in FIELDS if one.slot >= FIRST_FURTHER_SLOT)
