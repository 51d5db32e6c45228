"""Description of one field of a JSON schema, as text."""

from typing import Any

Schema = dict[str, Any]


def resolved(root: Schema, field: Schema) -> Schema:
    """Return `field` with its reference resolved."""
    choice = next((item for item in field.get("anyOf", []) if item.get("type") != "null"), {})
    inner = field | choice | field.get("items", {})
    return field | root["$defs"][inner["$ref"].rpartition("/")[2]] if "$ref" in inner else field


def described(root: Schema, field: Schema, required: bool) -> tuple[str, str, str, str]:
    """Return unit, range, default and meaning of one key."""
    default = (
        "required"
        if required
        else "not set"
        if field.get("default") is None
        else f"`{_toml(field['default'])}`"
    )
    return (
        field.get("unit", ""),
        taken(field),
        default,
        " ".join(field.get("description", "").split()),
    )


def taken(field: Schema) -> str:
    """Return the type, range or choices of a field."""
    for choice in field.get("anyOf", []):
        if choice.get("type") != "null":
            return taken(choice)
    if "enum" in field or "const" in field:
        return ", ".join(f"`{_toml(item)}`" for item in field.get("enum", [field.get("const")]))
    low = field.get("minimum", field.get("exclusiveMinimum"))
    high = field.get("maximum", field.get("exclusiveMaximum"))
    above = ">" if "exclusiveMinimum" in field else ">="
    below = "<" if "exclusiveMaximum" in field else "<="
    limits = [
        f"{sign} {limit:g}" for sign, limit in ((above, low), (below, high)) if limit is not None
    ]
    return " ".join([field.get("type", "any"), ", ".join(limits)]).strip()


def _toml(value: Any) -> str:
    return (
        str(value).lower()
        if isinstance(value, bool)
        else f'"{value}"'
        if isinstance(value, str)
        else str(value)
    )
