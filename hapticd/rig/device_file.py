"""Write measured values into a device file, and leave comments and all other text unchanged.

tomlkit edits the text: existing values in place, missing keys after the last key of their table,
missing tables at the end. The result does not rely on tomlkit alone: another parser reads the new
text, which must contain the old data with only these values changed. Then it is validated like
every device file, in a temporary file that replaces the old one atomically. Until then the old file
is untouched, whatever fails.

A table may be nested, like `model.masses`. Tables with `measured_on`, `measured_by`, `serial`,
`half_width_95` and `source` record when, by which step, on which board and with which interval
their values were measured. In a table of an effect `source` is a tag, and `note` has the text. Raw
records are kept next to the device file (`keep`), which names them with their SHA-256.

Limitations: if two programs write at the same time, the last one wins, with its whole file.
"""

import copy
import datetime
import hashlib
import os
import shutil
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import tomlkit
from tomlkit.items import InlineTable, Table

from hapticd.core.errors import ConfigError
from hapticd.rig.result import Change, Written
from hapticd.settings.device import DeviceFile
from hapticd.settings.load import load_device
from hapticd.settings.tables import keys_of
from hapticd.settings.toml import read, shipped

__all__ = ["keep", "refuse_shipped", "write"]

Stated = Written | datetime.date | Mapping[str, float]
Values = Mapping[tuple[str, str], Stated]  # by table and key
_DIGITS = 12  # digits of the hash of a kept file


def keep(
    device_file: Path, step: str, day: datetime.date, arrays: Mapping[str, npt.NDArray[Any]]
) -> str:
    """Write `arrays` next to `device_file` as rig/NAME-DATE-STEP.npz, and keep earlier files of
    that day. Return that name, and the first digits of the SHA-256.
    """
    folder = device_file.parent / "rig"
    folder.mkdir(exist_ok=True)
    stem = f"{device_file.stem}-{day.isoformat()}-{step}"
    names = (f"{stem}{f'-{number}' if number > 1 else ''}.npz" for number in range(1, 1000))
    path = next(folder / name for name in names if not (folder / name).exists())
    partial = path.with_suffix(".partial")
    with partial.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
    os.replace(partial, path)
    return f"rig/{path.name} {hashlib.sha256(path.read_bytes()).hexdigest()[:_DIGITS]}"


def write(
    path: Path, changes: Iterable[Change], step: str, day: datetime.date, words: str = ""
) -> DeviceFile:
    """Write `changes` into the device file `path`, and return the device as changed. A table in
    which more than a sign or an offset changes also gets `step` (a `params.RigStep`), `day`, the
    board's serial, half widths of intervals, and `words` for people. ConfigError leaves the file
    unchanged.
    """
    refuse_shipped(path)
    read(path)  # says what is wrong with a file that is no TOML
    asked = list(changes)
    values: dict[tuple[str, str], Stated] = {(one.table, one.key): one.value for one in asked}
    before = tomllib.loads(path.read_text("utf-8"))
    provenance: dict[str, Stated] = {
        "measured_on": day,
        "measured_by": step,
        "serial": str(before.get("serial", "")),
        "source": f"{step}: {words}" if words else step,
    }
    # a sign or an offset alone gives no information about how well the scale is known
    for table in dict.fromkeys(one.table for one in asked if not _beside(one)):
        told = provenance
        if table.startswith("model."):
            told = {**provenance, "source": "calibrated", "note": provenance["source"]}
        for key in told.keys() & keys_of(DeviceFile, tuple(table.split("."))):
            values.setdefault((table, key), told[key])
        halves = {
            one.key: one.half_width_95
            for one in asked
            if one.table == table and one.half_width_95 is not None
        }
        if halves or "half_width_95" in before.get(table, {}):
            values[table, "half_width_95"] = halves
    return _replace(path.resolve(), changed(path.read_bytes().decode("utf-8"), values))


def refuse_shipped(path: Path) -> None:
    """Raise ConfigError for a device file of this package, which an update would replace."""
    if path.resolve().is_relative_to(shipped("config").resolve()):
        raise ConfigError(
            f"{path} is shipped with hapticd; copy it to devices/NAME.toml beside your hapticd.toml"
            " and name it there"
        )


def _beside(change: Change) -> bool:
    return change.key == "sign" or (change.table, change.key) == ("force", "offset_count")


def _replace(path: Path, text: str) -> DeviceFile:
    """Replace the file `path` with `text`, once that is a valid device file."""
    fresh = path.with_name(f".{path.stem}.new.toml")
    try:
        with fresh.open("wb") as file:
            file.write(text.encode("utf-8"))
            file.flush()
            os.fsync(file.fileno())
        device = load_device(fresh)
        shutil.copymode(path, fresh)
        os.replace(fresh, path)
    finally:
        fresh.unlink(missing_ok=True)
    return device


def changed(text: str, values: Values) -> str:
    """Return the TOML `text` with `values`. ConfigError if it cannot be changed in this way."""
    expected = copy.deepcopy(tomllib.loads(text))
    document = tomlkit.parse(text)
    try:
        for (table, key), value in values.items():
            _set(_table(document, table), key, _item(value))
            _set_plain(expected, table, key, _plain(value))
        found = document.as_string()
        understood = tomllib.loads(found) == expected
    except (tomllib.TOMLDecodeError, tomlkit.exceptions.TOMLKitError):
        understood = False
    if not understood:
        names = ", ".join(
            f"{table}.{key} = {_item(value).as_string()}" for (table, key), value in values.items()
        )
        raise ConfigError(
            f"the device file is laid out in a way that is not understood: write {names}"
        )
    return found


def _plain(value: Stated) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _item(value: Stated) -> Any:
    """`value` as tomlkit writes it: mappings on one line."""
    if not isinstance(value, Mapping):
        return tomlkit.item(_plain(value))
    table = tomlkit.inline_table()
    table.update(value)
    return table


def _table(document: Any, dotted: str) -> Any:
    """Return the table `dotted`, creating it if missing. ParseError if the name holds a plain
    value.
    """
    found = document
    for name in dotted.split("."):
        if name not in found:
            found[name] = tomlkit.table()
        found = found[name]
        if isinstance(found, InlineTable) or not hasattr(found, "items"):
            raise tomlkit.exceptions.TOMLKitError(f"{name} is not a table of its own")
    return found


def _set(table: Any, key: str, value: Any) -> None:
    """Set `key = value` after the last value of `table`, before the comments that follow it."""
    body = table.value.body if isinstance(table, Table) else []
    named = [place for place, (name, _) in enumerate(body) if name is not None]
    nested = any(isinstance(item, Table) for _, item in body)
    if key in table or nested or not named:
        table[key] = value
        return
    after = body[named[-1] + 1 :]
    del body[named[-1] + 1 :]
    table[key] = value
    body.extend(after)


def _set_plain(data: dict[str, Any], dotted: str, key: str, value: Any) -> None:
    for name in dotted.split("."):
        data = data.setdefault(name, {})
    data[key] = value
