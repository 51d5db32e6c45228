"""The base of every TOML table, and validation errors as sentences.

A sentence names file:line, field = value with its unit, what is allowed, what was probably meant.

Tables are strict (no "100" for 100), closed (no unknown key), frozen, and refuse NaN and infinity.
Units live in the names of fields; `core.units.unit_of` reads them for messages and for the JSON
schema.

What would break it: a pydantic release that renames its error types (`REASONS` would fall back to
pydantic's own words).
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import is_dataclass
from typing import Any, get_args, get_type_hints

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from hapticd.core.errors import ConfigError
from hapticd.core.units import unit_of
from hapticd.settings.toml import KeyPath, did_you_mean

__all__ = ["dotted", "keys_of", "leaves"]

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


def config_error(error: ValidationError, model: type[BaseModel], where: Where) -> ConfigError:
    """Everything that is wrong, one line each. `where` tells file and line of a key."""
    return ConfigError("\n".join(_line(detail, model, where) for detail in error.errors()))


def dotted(path: KeyPath) -> str:
    """("a", 0, "b") -> a[0].b"""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path)
    return text.removeprefix(".")


def leaves(table: Any, path: KeyPath = ()) -> Iterator[tuple[KeyPath, Any]]:
    """(path, value) of everything in `table` that is not a table itself."""
    if isinstance(table, dict):
        for name, item in table.items():
            yield from leaves(item, (*path, name))
    else:
        yield path, table


def _line(detail: ErrorDetails, model: type[BaseModel], where: Where) -> str:
    path = detail["loc"]
    return f"{where(path)}: {dotted(path)}{_shown(detail)}: {_reason(detail, model)}"


def _shown(detail: ErrorDetails) -> str:
    """` = value unit`, where the value itself is what is wrong."""
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
    """The unit of the key behind a blank, or nothing."""
    path = detail["loc"]
    unit = unit_of(str(path[-1])) if path else ""
    return f" {unit}" if unit else ""


def _show(value: Any) -> str:
    """`value` as TOML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, str) else str(value)


def keys_of(table: Any, path: KeyPath = ()) -> list[str]:
    """The keys of the table at `path` in `table`, a model or a dataclass."""
    for step in path:
        # a number is a place in a list of tables: the table is the same
        if isinstance(step, str):
            table = _table_of(get_type_hints(table)[step])
    return list(getattr(table, "model_fields", None) or table.__dataclass_fields__)


def _table_of(hint: Any) -> Any:
    """The table inside `Table`, `Table | None` or `tuple[Table, ...]`."""
    return next(
        kind
        for kind in (hint, *get_args(hint))
        if hasattr(kind, "model_fields") or is_dataclass(kind)
    )
