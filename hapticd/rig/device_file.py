"""Measured values into a device file, comments and everything else left as they are.

Only lines `key = value` of a table [name] are changed; a key that is missing is added at the end of
its table, and a missing table at the end of the file. So that nothing depends on how well text is
understood, the new text is parsed again: it must say what the old one did, but for these values.
Then it is validated as every device file is, in a file beside, which takes the place of the old one
in one step. Until then the old file is untouched, whatever happens.

What would break it: a value that spans lines (refused), two programs that write at once (the last
one wins, whole).
"""

import copy
import datetime
import os
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, get_args

from hapticd.errors import ConfigError
from hapticd.rig.result import Change, Scalar
from hapticd.settings.device import DeviceFile
from hapticd.settings.load import load_device
from hapticd.settings.toml import shipped

Written = Scalar | datetime.date

_KEY = r"^(\s*{key}\s*=\s*)"
_VALUE = re.compile(r"""("(?:[^"\\]|\\.)*"|'[^']*'|[^\s#"'\[{]+)(\s*(?:#.*)?)$""")
_HEADER = re.compile(r"^\s*\[")


def write(path: Path, changes: Iterable[Change], source: str, day: datetime.date) -> DeviceFile:
    """Write `changes` into the device file `path`, with `source` and `day` in every table that has
    such keys, where more than its sign is written; the device as it is then. ConfigError leaves
    the file as it was.
    """
    refuse_shipped(path)
    asked = list(changes)
    values: dict[tuple[str, str], Written] = {(one.table, one.key): one.value for one in asked}
    provenance: dict[str, Written] = {"date": day, "source": source}
    # a sign that was seen says nothing of how the scale beside it is known
    for table in dict.fromkeys(one.table for one in asked if one.key != "sign"):
        told = provenance.keys() & set(_fields(table))
        values |= {(table, key): provenance[key] for key in sorted(told)}
    text = changed(path.read_text(encoding="utf-8"), values)
    return _replace(path, text)


def refuse_shipped(path: Path) -> None:
    """ConfigError for a device file of this package, which an update would replace."""
    if path.resolve().is_relative_to(shipped("config").resolve()):
        raise ConfigError(
            f"{path} is shipped with hapticd; copy it to devices/NAME.toml beside your hapticd.toml"
            " and name it there"
        )


def _fields(table: str) -> Iterable[str]:
    annotation: Any = DeviceFile.model_fields[table].annotation
    kinds = (annotation, *get_args(annotation))  # of a table that may be left out
    return next(kind.model_fields for kind in kinds if hasattr(kind, "model_fields"))


def _replace(path: Path, text: str) -> DeviceFile:
    """`text` in place of the file `path`, once it is a valid device file."""
    fresh = path.with_name(f".{path.stem}.new.toml")
    try:
        with fresh.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        device = load_device(fresh)
        os.replace(fresh, path)
    finally:
        fresh.unlink(missing_ok=True)
    return device


def changed(text: str, values: dict[tuple[str, str], Written]) -> str:
    """The TOML `text` with `values` by (table, key). ConfigError if it cannot be changed so."""
    expected = copy.deepcopy(tomllib.loads(text))
    lines = text.splitlines()
    for (table, key), value in values.items():
        lines = _with(lines, table, key, _toml(value))
        expected.setdefault(table, {})[key] = value
    found = "\n".join(lines) + "\n"
    try:
        understood = tomllib.loads(found) == expected
    except tomllib.TOMLDecodeError:
        understood = False
    if not understood:
        names = ", ".join(
            f"{table}.{key} = {_toml(value)}" for (table, key), value in values.items()
        )
        raise ConfigError(
            f"the device file is laid out in a way that is not understood: write {names}"
        )
    return found


def _toml(value: Written) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return value.isoformat() if isinstance(value, datetime.date) else repr(value)


def _with(lines: list[str], table: str, key: str, value: str) -> list[str]:
    """`lines` with `key = value` in `[table]`."""
    header = re.compile(rf"^\s*\[\s*{re.escape(table)}\s*\]")
    start = next((place for place, line in enumerate(lines) if header.match(line)), None)
    if start is None:
        return [*lines, "", f"[{table}]", f"{key} = {value}"]
    after = range(start + 1, len(lines))
    end = next((place for place in after if _HEADER.match(lines[place])), len(lines))
    entry = re.compile(_KEY.format(key=re.escape(key)))
    for place in range(start + 1, end):
        if head := entry.match(lines[place]):
            rest = _VALUE.match(lines[place][head.end() :])
            comment = rest[2] if rest else ""
            return [*lines[:place], f"{head[1]}{value}{comment}", *lines[place + 1 :]]
    last = max(place for place in range(start, end) if lines[place].split("#")[0].strip())
    return [*lines[: last + 1], f"{key} = {value}", *lines[last + 1 :]]
