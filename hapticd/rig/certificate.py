"""The certificate of a rig: what was verified, when, and on which device, as JSON and as one page.

It belongs to one device file (by the hash of its bytes) and to one board (by serial number,
firmware and life). It lists everything that the numbers depend on: every calibration with date,
board and interval, the versions of hapticd and of its libraries, and the machine. Items that were
not verified are listed as prominently as the verified ones. The page is self-contained HTML, so it
prints and can be archived.

`recording.provenance` finds the certificate and reports whether the device file has changed since.

Each verification of a step must be a finding.
"""

import html
import json
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from operator import itemgetter
from pathlib import Path
from typing import Any

from hapticd.core.params import to_plain
from hapticd.protocol.answers import Hello, Status
from hapticd.recording.provenance import (
    RECORDING_LIBRARIES,
    certificate_path,
    commit,
    processor,
    provenance,
    used_scales,
    versions,
)
from hapticd.rig.experiment import BoardIdentity
from hapticd.rig.result import StepResult

__all__ = ["content", "write"]

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
    result: StepResult, now: datetime, hello: Hello, status: Status, board: BoardIdentity
) -> dict[str, Any]:
    """Return the certificate as JSON values. `result` is that of `verify`, for the device of the
    daemon that sent `hello`. `status` contains the real-time rights that its servo obtained.
    """
    servo = to_plain(hello.servo)
    device = servo["device"]
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
        "software": provenance(commit=commit(), recording=versions(RECORDING_LIBRARIES)),
        "machine": {
            "kernel": f"{platform.system()} {platform.release()}",
            "cpu": processor(),
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


def write(said: Mapping[str, Any], device_file: Path) -> list[Path]:
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
