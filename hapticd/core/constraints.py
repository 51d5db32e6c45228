"""Limits of a setting, declared with it: `rate_hz: Annotated[float, Constraints(ge=50)]`.

The parameters of one TOML table (`TableParams`) are declared once, in `core.params`: fields are
keys, defaults are those of the file, and attribute docstrings describe a key in the JSON schema.
`settings` passes these classes to pydantic, which calls the methods below. No code here imports
pydantic, and the servo process runs without it.
"""

from inspect import cleandoc
from typing import Annotated, Any

__all__ = [
    "Constraints",
    "Duration",
    "Microseconds",
    "NotNegative",
    "Positive",
    "ServoRateHz",
    "TableParams",
]


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
