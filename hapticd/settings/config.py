"""hapticd.toml, and the base of every TOML table with the messages for its mistakes.

Messages (`Parsed`). A message contains file:line, field = value with its unit, the permitted range,
and a suggestion.

Rules (`parsed`, `concerns`). A rule between keys needs a table. To check them despite a misspelt
key or a wrong number, wrong entries are replaced by their defaults for the check. A rule counts
only if no wrong entry is near its keys.

Base (`TomlTable`). Tables are strict (no "100" for 100), closed (no unknown key), frozen, and
refuse NaN and infinity. Units are part of field names; `core.units.unit_of` reads them for messages
and for the JSON schema.

Limitations: a pydantic release that renames its error types (`REASONS` would fall back to
pydantic's own text). A rule whose limit comes from another table that it does not list.

hapticd.toml (`Config`). Its settings apply to any device. Tables that the processes read unchanged
are in `core.params` and `model.params`, with their defaults and limits. The tables here are
translated. `load` checks the limits of a device.
"""

import copy
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, is_dataclass
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Generic,
    Literal,
    TypeVar,
    get_args,
    get_type_hints,
)

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model
from pydantic_core import ErrorDetails

from hapticd.core.environment import (
    FIELDS,
    STRENGTHS,
    Constraints,
    Environment,
    FilterParams,
    Positive,
    TableParams,
    WallParams,
    WorkspaceParams,
)
from hapticd.core.errors import ConfigError
from hapticd.core.params import (
    GatewayParams,
    GuardTable,
    LeaseParams,
    RealtimeParams,
    SafetyParams,
    ServoParams,
    UsbTable,
)
from hapticd.core.units import unit_of
from hapticd.model.params import BoardTraits
from hapticd.settings.toml import KeyPath, did_you_mean

__all__ = ["Config", "dotted", "keys_of", "leaves", "validated"]

Where = Callable[[KeyPath], str]  # file:line of a key


class TomlTable(BaseModel):
    """One TOML table: strict, closed, frozen, finite. Dataclasses in it are as strict."""

    model_config = ConfigDict(
        strict=True,
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        validate_default=True,
        use_attribute_docstrings=True,
    )


UNKNOWN_KEY = ("extra_forbidden", "unexpected_keyword_argument")  # of a model, of a dataclass
NOT_A_TABLE = ("model_type", "dataclass_type", "tuple_type")
REASONS: Mapping[str, str] = {
    "greater_than": "must be more than {gt}{unit}",
    "greater_than_equal": "must be at least {ge}{unit}",
    "less_than": "must be less than {lt}{unit}",
    "less_than_equal": "must be at most {le}{unit}",
    "finite_number": "must be a finite number{of_unit}",
    "float_type": "must be a number{of_unit}",
    "int_type": "must be a whole number{of_unit}",
    "int_from_float": "must be a whole number{of_unit}",
    "bool_type": "must be true or false",
    "string_type": "must be text in quotes",
    "date_type": "must be a date like 2026-11-20",
    "model_type": "must be a table",
    "dataclass_type": "must be a table",
    "tuple_type": "must be a list of tables",
    "literal_error": "must be {expected}",
    "missing": "is missing; add it{of_unit}",
    "extra_forbidden": "is unknown",
    "unexpected_keyword_argument": "is unknown",
    "string_too_short": "must not be empty",
    "string_too_long": "must have at most {max_length} characters",
    "string_pattern_mismatch": "must be printable ASCII without blanks",
}


T = TypeVar("T", bound=TomlTable)


@dataclass(frozen=True)
class Parsed(Generic[T]):
    """A table without its `wrong` entries; None if no valid table is left."""

    table: T | None
    where: Where
    errors: str = ""  # a line for each mistake; empty if there is none
    wrong: tuple[KeyPath, ...] = ()

    @property
    def sound(self) -> T:
        """The table of a file. ConfigError with all mistakes if there is one."""
        if self.errors or self.table is None:
            raise ConfigError(self.errors)
        return self.table


def parsed(model: type[T], data: dict[str, Any], where: Where) -> Parsed[T]:
    """Parse `data` as `model`. `where` returns file and line of a key."""
    try:
        return Parsed(model.model_validate(data), where)
    except ValidationError as error:
        details = error.errors()
    wrong = tuple(detail["loc"] for detail in details)
    lines = "\n".join(_line(detail, model, where) for detail in details)
    return Parsed(_rest(model, data, wrong), where, lines, wrong)


def validated(model: type[T], data: dict[str, Any], where: Where) -> T:
    """Parse `data` as `model`. ConfigError with one line for each mistake."""
    return parsed(model, data, where).sound


def _rest(model: type[T], data: dict[str, Any], wrong: Iterable[KeyPath]) -> T | None:
    """Return `data` without the `wrong` entries as a table, if that is valid."""
    left = copy.deepcopy(data)
    for path in wrong:
        _take_out(left, path)
    try:
        return model.model_validate(left)
    except ValidationError:
        return None


def _take_out(data: dict[str, Any], path: KeyPath) -> None:
    """Remove the entry at `path`, or the whole list that contains it."""
    table: Any = data
    for step, below in zip(path, (*path[1:], ""), strict=True):
        if not isinstance(table, dict):
            return
        if step == path[-1] or isinstance(below, int):
            table.pop(step, None)
            return
        table = table.get(step)


def concerns(paths: Iterable[KeyPath], wrong: Iterable[KeyPath]) -> bool:
    """Return whether any of `wrong` is at one of `paths`, above it, or in the same table."""
    return any(
        mistake[: len(table)] == table or table[: len(mistake)] == mistake
        for table in [path[:-1] or path for path in paths]
        for mistake in wrong
    )


def dotted(path: KeyPath) -> str:
    """("a", 0, "b") -> a[0].b"""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path)
    return text.removeprefix(".")


def leaves(table: Any, path: KeyPath = ()) -> Iterator[tuple[KeyPath, Any]]:
    """Yield (path, value) of every entry in `table` that is not a table itself."""
    if isinstance(table, dict):
        for name, item in table.items():
            yield from leaves(item, (*path, name))
    else:
        yield path, table


def _line(detail: ErrorDetails, model: type[BaseModel], where: Where) -> str:
    path = detail["loc"]
    return f"{where(path)}: {dotted(path)}{_shown(detail)}: {_reason(detail, model)}"


def _shown(detail: ErrorDetails) -> str:
    """Return ` = value unit`, if the value itself is wrong."""
    if detail["type"] in ("missing", *UNKNOWN_KEY, *NOT_A_TABLE):
        return ""
    value = detail["input"]
    # not isinstance: a bool is an int, and has no unit
    unit = _unit(detail) if type(value) in (int, float) else ""
    return f" = {_show(value)}{unit}"


def _reason(detail: ErrorDetails, model: type[BaseModel]) -> str:
    path = detail["loc"]
    kind = detail["type"]
    unit = _unit(detail)
    words = {"unit": unit, "of_unit": f" in{unit}" if unit else "", **detail.get("ctx", {})}
    reason = REASONS[kind].format(**words) if kind in REASONS else detail["msg"]
    if kind in UNKNOWN_KEY:
        return reason + did_you_mean(str(path[-1]), keys_of(model, path[:-1]))
    if kind.endswith("_type") and kind != "string_type" and isinstance(detail["input"], str):
        return f"{reason}, without quotes"
    return reason


def _unit(detail: ErrorDetails) -> str:
    """Return the unit of the key after a blank, or an empty text."""
    path = detail["loc"]
    unit = unit_of(str(path[-1])) if path else ""
    return f" {unit}" if unit else ""


def _show(value: Any) -> str:
    """Return `value` in TOML notation."""
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, str) else str(value)


def keys_of(table: Any, path: KeyPath = ()) -> list[str]:
    """Return the keys of the table at `path` in `table`, a model or a dataclass."""
    for step in path:
        # a number is an index into a list of tables: the table is the same
        if isinstance(step, str):
            hint = get_type_hints(table)[step]  # Table, Table | None or tuple[Table, ...]
            kinds = (hint, *get_args(hint))
            table = next(one for one in kinds if hasattr(one, "model_fields") or is_dataclass(one))
    return list(getattr(table, "model_fields", None) or table.__dataclass_fields__)


# --- hapticd.toml ---------------------------------------------------------------------------------
_environment = Environment()
_wall = WallParams()
_ends = WorkspaceParams()
_active_damping_ns_per_m: Any = ServoParams.__dataclass_fields__["active_damping_ns_per_m"].default

Capability = Literal["probe", "temperature", "sample_phase", "resistance", "event"]
SERIAL_NUMBER: dict[str, Any] = {"min_length": 1, "max_length": 16, "pattern": r"^[!-~]+$"}


_RANGES: dict[str, Any] = {one.path: {"ge": one.low, "le": one.high} for one in FIELDS}
# numbers of the environment itself; the active damping has its own table
RENDERED = tuple(one.path for one in STRENGTHS if "." not in one.path)
FrequencyHz = Annotated[float, Field(**_RANGES["velocity_filter.frequency_hz"])]
DampingRatio = Annotated[float, Field(**_RANGES["velocity_filter.damping_ratio"])]


class Filter(TomlTable):
    frequency_hz: FrequencyHz
    """Corner of the second-order low-pass; at most 0.45 of the servo rate."""
    damping_ratio: DampingRatio = FilterParams(1.0).damping_ratio
    """0.7071 is Butterworth."""
    mapping: Literal["prewarped", "bilinear", "matched"] = "prewarped"
    """Discretisation of the filter."""


def _filter(default: FilterParams) -> Filter:
    return Filter(frequency_hz=default.frequency_hz, damping_ratio=default.damping_ratio)


class WallTable(TomlTable):
    stiffness_n_per_m: float = Field(_wall.stiffness_n_per_m, **_RANGES["wall.stiffness_n_per_m"])
    virtual_damping_ns_per_m: float = Field(
        _wall.virtual_damping_ns_per_m, **_RANGES["wall.virtual_damping_ns_per_m"]
    )
    position_m: float = Field(_wall.position_m, **_RANGES["wall.position_m"])
    side: Literal[-1, 0, 1] = 0
    """+1: solid beyond the position, -1: solid before it, 0: no wall."""


class Workspace(TomlTable):
    stiffness_n_per_m: float = Field(_ends.stiffness_n_per_m, ge=0, le=1e5)
    """Springs at both ends of the device's travel; 0: none."""
    margin_m: float = Field(0.0, ge=0, le=10)
    """Distance from each end of travel at which they begin."""


if TYPE_CHECKING:  # a generated model cannot be a base class for a type checker
    Rendered = TomlTable
else:
    Rendered = create_model(
        "Rendered",
        __base__=TomlTable,
        **{
            path: (float, Field(getattr(_environment, path), **limits))
            for path, limits in _RANGES.items()
            if path in RENDERED
        },
    )


class EnvironmentTable(Rendered):
    """The environment rendered at start; `hapticd set` changes it live."""

    velocity_filter: Filter = _filter(_environment.velocity_filter)
    acceleration_filter: Filter = _filter(_environment.acceleration_filter)
    wall: WallTable = WallTable()
    workspace: Workspace = Workspace()


@dataclass(frozen=True, slots=True)
class SimulatedBoard(TableParams):
    """Differences of the simulated board from its device file.

    Its hello reports them and it behaves accordingly; omitted fields follow the device file.
    """

    serial: Annotated[str, Constraints(**SERIAL_NUMBER)] | None = None
    """Only in the hello: it is still found by the device file's serial number."""
    lacks: Annotated[tuple[Capability, ...], Constraints(strict=False)] = ()
    """Capabilities that the board lacks."""
    position_m_per_count: Positive | None = None
    force_full_scale_n: Positive | None = None
    damping_full_scale_ns_per_m: Positive | None = None
    probe_torque_full_scale_n: Positive | None = None
    probe_velocity_full_scale_m_per_s: Positive | None = None
    current_full_scale_a: Positive | None = None
    voltage_full_scale_v: Positive | None = None
    force_limit_n: Positive | None = None
    """The board clamps the torque to this limit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulation(BoardTraits):
    """The simulated board's firmware; ignored with a real one."""

    sample_phase: Annotated[float, Constraints(ge=0, lt=1)] | None = None
    """Time at which the encoder is latched, in periods after the board received a command.

    Default: from the device's delay."""
    effects: Annotated[tuple[str, ...], Constraints(strict=False)] | None = None
    """Effects of the device to build. Default: those of its file."""
    board: SimulatedBoard = SimulatedBoard()


class Config(TomlTable):
    """hapticd.toml"""

    device: str = Field("simulated", min_length=1)
    """Name of a device file (devices/NAME.toml next to this file, or a shipped one), or a path."""
    active_damping_ns_per_m: float = Field(_active_damping_ns_per_m, ge=0)
    """Active damping of `hapticd damping on`."""
    environment: EnvironmentTable = EnvironmentTable()
    safety: SafetyParams = SafetyParams()
    realtime: RealtimeParams = RealtimeParams()
    usb: UsbTable = UsbTable()
    gateway: GatewayParams = GatewayParams()
    guard: GuardTable = GuardTable()
    lease: LeaseParams = LeaseParams()
    simulation: Simulation = Simulation()
