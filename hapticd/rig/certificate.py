"""Output files of a rig's measurements: the device file and the certificate.

Device file (`write_changes`). Measured values are written into it; comments and all other text
stay. tomlkit edits the text: existing values in place, missing keys after the last key of their
table, missing tables at the end. The result does not rely on tomlkit alone: another parser reads
the new text, which must contain the old data with only these values changed. Then it is validated
like every device file, in a temporary file that replaces the old one atomically. Until then the old
file is untouched, whatever fails.

A table may be nested, like `model.masses`. Tables with `measured_on`, `measured_by`, `serial`,
`half_width_95` and `source` record when, by which step, on which board and with which interval
their values were measured. In a table of an effect `source` is a tag, and `note` has the text. Raw
records are kept next to the device file (`keep`), which names them with their SHA-256.

Limitations: if two programs write at the same time, the last one wins, with its whole file.

Certificate (`write_certificate`). It states which verifications were made, when, and on which
device, as JSON and as one page. It belongs to one device file (by the hash of its bytes) and to one
board (by serial number, firmware and life). It lists everything that the numbers depend on: every
calibration with date, board and interval, the versions of hapticd and of its libraries, and the
machine. Items that were not verified are listed as prominently as the verified ones. The page is
self-contained HTML, so it prints and can be archived.

`recording.provenance` finds the certificate and reports whether the device file has changed since.

Each verification of a step must be a finding.
"""

import copy
import datetime
import hashlib
import html
import json
import os
import platform
import shutil
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import tomlkit
from tomlkit.items import InlineTable, Table

from hapticd.core.errors import ConfigError
from hapticd.core.params import to_plain
from hapticd.protocol.answers import Hello, Status
from hapticd.recording.provenance import certificate_path, here, used_scales
from hapticd.rig.experiment import BoardIdentity
from hapticd.rig.result import Change, StepResult, Written
from hapticd.settings.config import keys_of
from hapticd.settings.device import DeviceFile
from hapticd.settings.load import load_device
from hapticd.settings.toml import read, shipped

__all__ = ["content", "keep", "refuse_shipped", "write_certificate", "write_changes"]

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


def write_changes(
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
            _set(_toml_table(document, table), key, _item(value))
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


def _toml_table(document: Any, dotted: str) -> Any:
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


# --- the certificate ------------------------------------------------------------------------------
VERSION = 1
NOT_VERIFIED = (
    "active damping: `hapticd rig damping` measures it, `hapticd rig audit` compares it",
    "the hard-wired emergency stop: press it under a small force",
    "that a force ends without frames: of its watchdog `hapticd rig link` has the board's word"
    " alone, at torque 0; pull the plug under a small force",
    "behaviour above 150 Hz, and near the ends of the travel",
    "a hand that holds the handle: Z was measured with the handle free",
)
STYLE = """body{font:11pt/1.35 sans-serif;max-width:50em;margin:2em auto}h1{font-size:1.4em}
table{border-collapse:collapse;width:100%;margin:.5em 0}td,th{border-bottom:1px solid #bbb;
text-align:left;vertical-align:top;padding:.15em .6em .15em 0;font-size:9pt}
.refused{font-weight:bold}p.verdict{font-size:1.2em;font-weight:bold}
@media print{body{margin:0;max-width:none}}"""


def content(
    result: StepResult, now: datetime.datetime, hello: Hello, status: Status, board: BoardIdentity
) -> dict[str, Any]:
    """Return the certificate as JSON values. `result` is that of `verify`, for the device of the
    daemon that sent `hello`. `status` contains the real-time rights that its servo obtained.
    """
    servo = to_plain(hello.servo)
    device = servo["device"]
    own = here()
    done = [one for one in result.findings if one.verdict != "not done"]
    left = [one.what for one in result.findings if one.verdict == "not done"]
    return {
        "certificate": VERSION,
        "verdict": "verified" if result.settled else "not verified",
        "date": now.date().isoformat(),
        "time": now.isoformat(timespec="seconds"),
        "device": {
            "name": device["name"],
            "file": Path(servo["device_file"]).name,
            "file_sha256": servo["device_file_sha256"],
            "serial": board.serial or device["serial"],
            "firmware": board.firmware,
            "life": board.life,
            "simulated": servo["simulated"],
            "rate_hz": servo["realtime"]["rate_hz"],
            "config_hash": servo["config_hash"],
        },
        "values": [asdict(one) for one in result.values],
        "verified": [asdict(one) for one in done],
        "not_verified": [*left, *NOT_VERIFIED],
        "calibrations": _calibrations(device),
        "software": own["software"],
        "machine": {
            "kernel": f"{platform.system()} {platform.release()}",
            "cpu": own["cpu"],
            "realtime": status.servo.get("realtime", {}),
        },
    }


def _calibrations(device: Mapping[str, Any]) -> list[dict[str, str]]:
    """Every scale that measurements depend on; its source states values with intervals, as text."""
    return [
        {
            "table": table,
            "measured_on": scale["measured_on"] or "none",
            "measured_by": scale["measured_by"],
            "serial": scale.get("serial") or device["serial"],
            "source": scale["source"],
        }
        for table, scale in used_scales(device, probed=True).items()
    ]


def write_certificate(said: Mapping[str, Any], device_file: Path) -> list[Path]:
    """Write the certificate next to the device file, as JSON and as a page, and return both paths.
    It replaces an earlier certificate of the same device file.
    """
    path = certificate_path(device_file, said["device"]["file_sha256"])
    path.parent.mkdir(exist_ok=True)
    texts = {path.with_suffix(".html"): page(said), path: json.dumps(said, indent=1) + "\n"}
    for target, text in texts.items():
        partial = target.with_name(f".{target.name}")
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, target)
    return [path, path.with_suffix(".html")]


def page(said: Mapping[str, Any]) -> str:
    """Return the certificate `said` as one page of HTML."""
    device = said["device"]
    badge = "SIMULATED: no force left the computer. " if device["simulated"] else ""
    values = [(one["name"], _interval(one)) for one in said["values"]]
    found = map(itemgetter("verdict", "what", "remedy"), said["verified"])
    scales = map(itemgetter("table", "measured_on", "serial", "source"), said["calibrations"])
    parts = (
        f"<h1>Certificate of {_text(device['name'])}</h1>",
        f'<p class="verdict">{_text(badge)}{_text(said["verdict"])}, {_text(said["date"])}</p>',
        _table((), _about(said)),
        "<h2>Known parts, as the probe sees them</h2>",
        _table(("part", "value (95 %)"), values),
        "<h2>Checks</h2>",
        _table(("", "what", "what to do"), found),
        "<h2>Calibrations</h2>",
        _table(("table", "date", "board", "source"), scales),
        "<h2>Not verified</h2>",
        _table((), [(one,) for one in said["not_verified"]]),
        "<p>It holds for this device file and this board. Whoever changes the file, the board, its"
        " firmware or the mechanics repeats <code>hapticd rig verify</code>.</p>",
    )
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        f"<title>{_text(device['name'])}</title><style>{STYLE}</style></head>"
        f"<body>{''.join(parts)}</body></html>\n"
    )


def _about(said: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Device, board, machine and software, as rows of the first table."""
    device = said["device"]
    software = said["software"]
    libraries = ", ".join(f"{name} {one}" for name, one in software["libraries"].items())
    machine = said["machine"]
    life = "unknown" if device["life"] is None else device["life"]
    return [
        ("device", device["name"]),
        ("device file", f"{device['file']}, SHA-256 {device['file_sha256']}"),
        ("board", f"{device['serial']}, firmware {device['firmware'] or 'unknown'}, life {life}"),
        ("rate", f"{device['rate_hz']:g} Hz"),
        ("verified at", said["time"]),
        ("software", f"hapticd {software['hapticd']} {software['commit']}"),
        ("libraries", f"Python {software['python']}, {libraries}"),
        ("machine", f"{machine['cpu']}, {machine['kernel']}"),
        (
            "real-time rights",
            "; ".join(f"{name}: {one['text']}" for name, one in machine["realtime"].items()),
        ),
    ]


def _interval(value: Mapping[str, Any]) -> str:
    return f"{value['value']:.4g} {value['unit']} ({value['low']:.4g} to {value['high']:.4g})"


def _table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    def line(cells: Sequence[Any], tag: str) -> str:
        kind = " class='refused'" if cells and cells[0] == "refused" else ""
        return f"<tr{kind}>{''.join(f'<{tag}>{_text(cell)}</{tag}>' for cell in cells)}</tr>"

    top = line(head, "th") if head else ""
    return f"<table>{top}{''.join(line(row, 'td') for row in rows)}</table>"


def _text(value: Any) -> str:
    return html.escape(str(value))
