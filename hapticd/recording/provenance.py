"""The provenance of numbers: software and its versions; for a recording also device, configuration,
machine, rights, clocks.

Every stored run or recording contains it, so that its numbers can be traced to the code, the
libraries and the machine that made them. Libraries of extras are imported on first use, because the
package must import without them.

Attributes of the daemon must come from its own messages, not from this machine, because the daemon
may run on another one.
"""

import hashlib
import importlib.metadata
import json
import platform
import subprocess
import time
import uuid
from contextlib import suppress
from datetime import UTC, datetime
from math import nan
from pathlib import Path
from typing import Any

import hapticd
from hapticd.core.params import to_plain
from hapticd.core.units import NS_PER_S
from hapticd.protocol.answers import Hello, Status
from hapticd.recording.calibrations import doubts
from hapticd.recording.certificate import certificate_of

__all__ = ["RECORDING_LIBRARIES", "commit", "processor", "provenance", "versions"]

SCHEMA = "hapticd-recording/1"
SIMULATED_NOTICE = "SIMULATED: the device behind this recording was computed"
RUN_LIBRARIES = ("numpy", "numba", "scipy", "h5py")
RECORDING_LIBRARIES = ("numpy", "h5py", "pyzmq", "msgpack")
DESCRIBE = ("describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
GIT_TIMEOUT_S = 5.0


def provenance(**more: Any) -> dict[str, Any]:
    """Return the provenance of a run: the versions behind its numbers, and further items."""
    return {
        "hapticd": hapticd.__version__,
        "python": platform.python_version(),
        "libraries": versions(RUN_LIBRARIES),
        **more,
    }


def versions(libraries: tuple[str, ...]) -> dict[str, str]:
    """Return versions by name, of those `libraries` that are installed."""
    found = {}
    for name in libraries:
        with suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


def of_recording(hello: Hello, status: Status, header: dict[str, Any], note: str) -> dict[str, Any]:
    """Return the attributes of a recording, from the daemon's hello and status, and from the header
    of the first block of records.

    mono_ns and utc_ns are one instant on the clock of `time_ns` and in Unix time. The attributes
    list the calibrations in doubt that day and the certificate of the rig.
    """
    servo = to_plain(hello.servo)
    now_ns = time.time_ns()
    now = datetime.fromtimestamp(now_ns / NS_PER_S, UTC)
    device = servo["device"]
    report = status.servo
    return {
        "schema": SCHEMA,
        "uuid": str(uuid.uuid4()),
        "started_utc": now.isoformat(),
        "mono_ns": now_ns - header["mono_unix_offset_ns"],
        "utc_ns": now_ns,
        "simulated": int(header["simulated"]),
        "notice": SIMULATED_NOTICE if header["simulated"] else "",
        "instance": hello.instance,
        "rate_hz": hello.rate_hz,
        "layout": header["layout"],
        "device_name": device["name"],
        "device_serial": device["serial"],
        "device_hash": hashlib.sha256(json.dumps(device, sort_keys=True).encode()).hexdigest(),
        "calibration": json.dumps(
            {
                name: scale["measured_on"]
                for name, scale in device.items()
                if isinstance(scale, dict) and "measured_on" in scale
            }
        ),
        "calibration_doubts": _json(list(map(str, doubts(servo, now.astimezone().date())))),
        "certificate": _json(certificate_of(servo)),
        "config_hash": status.config_hash or servo["config_hash"],
        "configuration": json.dumps(servo),
        "realtime": json.dumps(report.get("realtime", {})),
        "board": json.dumps(report.get("board", {})),
        # held at the start; later ones are events of kind lease
        "leases": json.dumps(
            {what: f"{held.name} (actor {held.actor})" for what, held in status.leases.items()}
        ),
        # null if the board does not measure it
        "winding_c": nan if status.winding_c is None else float(status.winding_c),
        "hapticd_version": hapticd.__version__,
        "hapticd_commit": commit(),
        "server_version": hello.version,
        "python": platform.python_version(),
        "libraries": json.dumps(versions(RECORDING_LIBRARIES)),
        "kernel": f"{platform.system()} {platform.release()} {platform.version()}",
        "cpu": processor(),
        "note": note,
    }


def _json(value: Any) -> str:
    """`value` as an attribute; "" for nothing."""
    return json.dumps(value) if value else ""


def commit(folder: Path = Path(hapticd.__file__).parent) -> str:
    """Return the commit of the running checkout, with -dirty if it was edited; empty for an
    installed package or without git.
    """
    command = ["git", "-C", str(folder), *DESCRIBE]
    try:
        return subprocess.run(
            command, capture_output=True, text=True, timeout=GIT_TIMEOUT_S, check=True
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""


def processor() -> str:
    """Name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.machine()
    return next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")),
        platform.machine(),
    )
