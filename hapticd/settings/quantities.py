"""The base of every TOML table. Units live in the names of fields; `hapticd.units.unit_of` reads them."""

from typing import Any

from pydantic import BaseModel, ConfigDict

from hapticd.units import unit_of


def _say_units(schema: dict[str, Any]) -> None:
    for name, entry in schema.get("properties", {}).items():
        entry.pop("title", None)  # only repeats the name
        if unit := unit_of(name):
            entry["unit"] = unit


class Table(BaseModel):
    """One TOML table: strict, closed, frozen, finite; its JSON schema says the units."""

    model_config = ConfigDict(
        strict=True,
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        validate_default=True,
        use_attribute_docstrings=True,
        json_schema_extra=_say_units,
    )
