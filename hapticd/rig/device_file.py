"""Measured values into a device file, comments and everything else left as they are.

tomlkit changes the text: values in place, keys that are missing behind the last one of their
table, tables that are missing at the end. So that nothing depends on how well it does so, the new
text is parsed again by another parser: it must say what the old one did, but for these values. Then
it is validated as every device file is, in a file beside, which takes the place of the old one in
one step. Until then the old file is untouched, whatever happens.

A table may be one of another, `model.masses`. Tables with `measured_on`, `measured_by`, `serial`,
`half_width_95` and `source` say there when, by which step, at which board and how well their values
were measured; in a table of an effect `source` is a tag, and `note` has the words. Raw records are
kept beside it (`keep`): the device file names them, with their SHA-256.

Limitations: two programs that write at once (the last one wins, whole).
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
_DIGITS = 12  # of the hash of a kept file


def keep(
    device_file: Path, step: str, day: datetime.date, arrays: Mapping[str, npt.NDArray[Any]]
) -> str:
    """Write `arrays` beside `device_file`, as rig/NAME-DATE-STEP.npz; an earlier file of that day
    stays. Returns the name in that form, and the first digits of the SHA-256.
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
    """Write `changes` into the device file `path`. Tables in which more than a sign is written say
    by which `step` (a `params.RigStep`) and on which day, with the board's serial, half widths of
    intervals, and `words` for people. Returns the device as it is then. ConfigError leaves the file
    as it was.
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
    # a sign or an offset by itself says nothing of how the scale beside it is known
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
    """ConfigError for a device file of this package, which an update would replace."""
    if path.resolve().is_relative_to(shipped("config").resolve()):
        raise ConfigError(
            f"{path} is shipped with hapticd; copy it to devices/NAME.toml beside your hapticd.toml"
            " and name it there"
        )


def _beside(change: Change) -> bool:
    return change.key == "sign" or (change.table, change.key) == ("force", "offset_count")


def _replace(path: Path, text: str) -> DeviceFile:
    """`text` in place of the file `path`, once it is a valid device file."""
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
    """The TOML `text` with `values`. ConfigError if it cannot be changed so."""
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
    """The table `dotted`, made where there is none. ParseError where a value stands for it."""
    found = document
    for name in dotted.split("."):
        if name not in found:
            found[name] = tomlkit.table()
        found = found[name]
        if isinstance(found, InlineTable) or not hasattr(found, "items"):
            raise tomlkit.exceptions.TOMLKitError(f"{name} is not a table of its own")
    return found


def _set(table: Any, key: str, value: Any) -> None:
    """`key = value`, behind the last value of `table` and before the comments that follow it."""
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
