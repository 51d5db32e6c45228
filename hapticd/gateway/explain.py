"""Wrong requests in words: field, value, what it takes with unit and limit, and what to do. And the schema for machines.

Nothing that a client sent is repeated but in printable ASCII and cut short.
"""

from difflib import get_close_matches
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from hapticd.errors import CommandError
from hapticd.gateway.codec import SHOWN, shown
from hapticd.gateway.limits import Limits
from hapticd.gateway.schemas import ADAPTER, MODELS, PROTOCOL_VERSION, Filters, Request, Table, Wall

MOST_DETAILS = 8
_BRANCHES = frozenset({"list[float]", "bytes", "float", "literal['on','off']"})  # names of union members in an error's path
_REMEDY = "the command `schema` lists what is allowed"


def parse(plain: dict[str, Any], limits: Limits) -> Request:
    """The request in `plain`. CommandError `unsupported_version` or `invalid`, with one line per wrong field."""
    version = plain.get("v", PROTOCOL_VERSION)
    if type(version) is int and version != PROTOCOL_VERSION:
        raise CommandError(
            "unsupported_version", f"v = {shown(version)}: this gateway speaks {PROTOCOL_VERSION}; use a client of the same release"
        )
    try:
        request = ADAPTER.validate_python(plain)
    except ValidationError as error:
        found = [_explained(item, limits) for item in error.errors(include_url=False)]
        raise invalid(list({item["loc"]: item for item in reversed(found)}.values())[::-1]) from error
    if broken := limits.broken_by(request.given):
        raise invalid(broken)
    return request


def invalid(detail: list[dict[str, str]]) -> CommandError:
    """The error for a request that breaks the schema or a limit; `detail` is a list of {loc, msg}."""
    detail = detail[:MOST_DETAILS]
    return CommandError("invalid", "; ".join(item["msg"] for item in detail), detail)


def _explained(item: ErrorDetails, limits: Limits) -> dict[str, str]:
    command, *path = [str(part) for part in item["loc"]] or [""]
    names = [part for part in path if part not in _BRANCHES]
    loc, value = ".".join(map(shown, names)), shown(item["input"])
    if item["type"].startswith("union_tag"):
        asked = item["input"].get("cmd", "") if isinstance(item["input"], dict) else ""
        reason = f"unknown command{_meant(asked, tuple(MODELS))}; known: {', '.join(MODELS)}"
        return {"loc": "cmd", "msg": f"cmd = {shown(asked)}: {reason}"}
    if item["type"] == "extra_forbidden":
        return {"loc": loc, "msg": f"{loc}: unknown field{_meant(names[-1], _fields(command, names))}; {_REMEDY}"}
    if item["type"] == "missing":
        return {"loc": loc, "msg": f"{loc}: missing; {_REMEDY}"}
    if item["type"] == "value_error" and not loc:
        return {"loc": command, "msg": f"{command}: {item['ctx']['error']}"}
    reason = item["msg"].removeprefix("Value error, ")
    remedy = limits.remedy(loc.partition(".")[0] if loc.startswith("samples_n") else loc) or _REMEDY
    return {"loc": loc or command, "msg": f"{loc or command} = {value}: {shown(reason, 120)}; {remedy}"}


def _meant(name: Any, known: tuple[str, ...]) -> str:
    lower = {one.lower(): one for one in known}
    near = get_close_matches(str(name)[:SHOWN].lower(), lower, n=1)
    return f", did you mean {lower[near[0]]!r}?" if near else ""


def _fields(command: str, names: list[str]) -> tuple[str, ...]:
    parts: dict[str, type[Table]] = {"filters": Filters, "wall": Wall}
    part = parts.get(names[0]) if len(names) > 1 else MODELS.get(command)
    return tuple(part.model_fields) if part else ()


def json_schema(limits: Limits) -> dict[str, Any]:
    """The protocol as JSON schema, with unit, minimum and maximum of every limited field on this device."""
    schema: dict[str, Any] = ADAPTER.json_schema()
    for title, model in schema["$defs"].items():
        part = {"Filters": "filters.", "Wall": "wall."}.get(title, "")
        for name, field in model.get("properties", {}).items():
            if field.get("default", ...) is None and name != "id":
                del field["default"]
            if part + name in limits.of and name != "samples_n":
                limit = limits.of[part + name]
                field |= {"unit": limit.unit, "minimum": limit.low, "maximum": limit.high}
    return schema
