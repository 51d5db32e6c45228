"""hapticd.toml and device files, key by key."""

from collections.abc import Iterator

from hapticd.settings.scene import SCHEMA_FILES, schema
from pages.markdown import table
from pages.schemas import Schema, described, resolved


def settings_page(kind: str, title: str) -> str:
    """Return every key of hapticd.toml or of a device file, with unit, range and default."""
    found = schema(kind)
    parts = [
        f"# {title}\n",
        f"{found.get('description', '')}\n",
        f"The schema for editors and checkers: `config/{SCHEMA_FILES[kind]}`.\n",
    ]
    for path, entry in tables(found, found, ()):
        heading = f"## `[{'.'.join(path)}]`\n" if path else ""
        rows = [
            (f"`{name}`", *described(found, field, name in entry.get("required", [])))
            for name, field in leaves(found, entry)
        ]
        if rows:
            parts += [
                heading,
                f"{entry.get('description', '')}\n" if path else "",
                table(("key", "unit", "takes", "default", "meaning"), rows),
            ]
    return "\n".join(parts)


def tables(
    root: Schema, entry: Schema, path: tuple[str, ...]
) -> Iterator[tuple[tuple[str, ...], Schema]]:
    """Yield (path, schema) of a table and all tables in it."""
    yield path, entry
    for name, field in entry["properties"].items():
        inner = resolved(root, field)
        if "properties" in inner:
            yield from tables(root, inner, (*path, name))


def leaves(root: Schema, entry: Schema) -> list[tuple[str, Schema]]:
    """Return (key, schema) of the keys that are not tables."""
    return [
        (name, field)
        for name, field in entry["properties"].items()
        if "properties" not in resolved(root, field)
    ]
