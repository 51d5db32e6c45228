"""The origin of numbers: calibrations and their doubts, certificate of the rig, and provenance.

Calibrations (`doubts`). Each scale of a device file contains the date and the board of its
measurement (`ScaleParams`). Measurements with the device depend on the scales of position and
force, and of those that it has or relies on: active damping, probe, winding temperature,
compensated resistance. A calibration is in doubt if its table has no date, a date after today, or
one older than the device file's `calibration_days`. It is also in doubt if it belongs to another
board, or if its scale of force has changed since (active damping is calibrated in newtons). A
simulated device matches its file by definition and needs no calibration. `used_scales` must list
every scale in use.

Certificate (`certificate_of`, `certificate_beside`). `hapticd rig verify` writes it next to the
device file, as rig/NAME-certificate-HASH.json. HASH is the first digits of the SHA-256 of the
device file at that time. A changed file has no certificate of its own; the newest existing one
describes its earlier state. Recordings, run folders and .zwidth files contain the result of these
functions, not the certificate itself. Limitations: a device file on another machine than the client
(it then has no certificate, without a message).

Provenance (`provenance`, `of_recording`). It states the software and its versions; for a recording
also device, configuration, machine, rights and clocks. Every stored run or recording contains it,
so that its numbers can be traced to the code, the libraries and the machine that made them.
Libraries of extras are imported on first use, because the package must import without them.
Attributes of the daemon must come from its own messages, not from this machine, because the daemon
may run on another one.
"""

import datetime
import hashlib
import importlib.metadata
import json
import platform
import subprocess
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any

import hapticd
from hapticd.core.errors import ConfigError
from hapticd.core.params import CALIBRATION_DAYS, to_plain
from hapticd.core.units import NS_PER_S
from hapticd.protocol.answers import Hello, Status
from hapticd.settings.toml import SETTINGS_BYTES, regular
from hapticd.usb.codec import I16_HIGHEST

__all__ = [
    "CalibrationDoubt",
    "certificate_beside",
    "certificate_of",
    "certificate_path",
    "doubts",
    "here",
    "provenance",
    "used_scales",
]

# --- calibrations ---------------------------------------------------------------------------------

SAME_SCALE = 0.01  # relative: tolerance of a repeated gain

STEPS = {
    "position": "encoder",
    "force": "motor",
    "active_damping": "damping",
    "probe_torque": "probe",
    "probe_velocity": "probe",
    "temperature": "temperature",
}  # by table of the device file, the step of `hapticd rig` that measures it


@dataclass(frozen=True, slots=True)
class CalibrationDoubt:
    """A doubtful calibration, with the reason."""

    table: str  # of the device file
    reason: str

    def __str__(self) -> str:
        return f"{self.table}: {self.reason}"

    @property
    def remedy(self) -> str:
        """The way to resolve the doubt."""
        if step := STEPS.get(self.table):
            return f"`hapticd rig {step}`"
        return (
            f"measure it, and write measured_on and serial into [{self.table}] of the device file"
        )


def used_scales(device: Mapping[str, Any], probed: bool = False) -> dict[str, Mapping[str, Any]]:
    """Return the scales, by table, behind measurements with `device`, as given in `hello`; with
    `probed` those of the probe as well.
    """
    names = ["position", "force"]
    if device["active_damping_limit_ns_per_m"] > 0.0:
        names.append("active_damping")
    if probed or "probe" in device["relies_on"]:
        names += ["probe_torque", "probe_velocity"]
    if "temperature" in device["relies_on"]:
        names.append("temperature")
    found: dict[str, Mapping[str, Any]] = {name: device[name] for name in names}
    if resistance := device.get("resistance"):
        found["resistance"] = resistance["trim"]
    return found


def doubts(
    servo: Mapping[str, Any], day: datetime.date, probed: bool = False
) -> tuple[CalibrationDoubt, ...]:
    """Return the calibrations in doubt at `day`, of the `servo` in a hello; with `probed` those of
    the probe as well.
    """
    if servo["simulated"]:
        return ()
    device = servo["device"]
    most = int(device.get("calibration_days", CALIBRATION_DAYS))
    return tuple(
        CalibrationDoubt(table, reason)
        for table, scale in used_scales(device, probed).items()
        for reason in (
            *_reasons(scale, str(device["serial"]), most, day),
            *_outlived(table, device),
        )
    )


def _outlived(table: str, device: Mapping[str, Any]) -> Iterator[str]:
    """Yield the reason if the active damping of `device` does not match its scale of force."""
    then_n = float(device.get("active_damping_with_force_n", 0.0))
    now_n = float(device["force"]["per_count"]) * I16_HIGHEST
    if table == "active_damping" and then_n and abs(now_n - then_n) > SAME_SCALE * then_n:
        yield (
            f"it was found with a scale of force of {then_n:g} N at full count, which is"
            f" {now_n:.6g} N now"
        )


def _reasons(scale: Mapping[str, Any], serial: str, most: int, day: datetime.date) -> Iterator[str]:
    of = str(scale.get("serial", ""))
    if of not in ("", serial):
        yield f"it is of the board {of!r}, this one is {serial!r}"
    if not scale["measured_on"]:
        yield "it has no date, so no measurement of it is known"
        return
    age = (day - datetime.date.fromisoformat(scale["measured_on"])).days
    if age > most:
        yield f"it is {age} days old ({scale['measured_on']}), {most} days are the limit"
    elif age < -1:  # a day for time zones
        yield f"it is dated {scale['measured_on']}, after today ({day.isoformat()})"


# --- certificate ----------------------------------------------------------------------------------

FOLDER = "rig"
DIGITS = 12  # of a hash in a name
CHANGED = "the device file has changed since; repeat `hapticd rig verify`"


def certificate_path(device_file: Path, device_file_sha256: str) -> Path:
    """Return the path of the certificate of `device_file` with that hash."""
    name = f"{device_file.stem}-certificate-{device_file_sha256[:DIGITS]}.json"
    return device_file.parent / FOLDER / name


def certificate_of(servo: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the certificate of the device file behind the `servo` of a hello; None if there is
    none, or the file is not on this machine.
    """
    if not servo.get("device_file"):
        return None
    return certificate_beside(Path(servo["device_file"]), servo["device_file_sha256"])


def certificate_beside(device_file: Path, device_file_sha256: str) -> dict[str, Any] | None:
    """Describe the certificate next to `device_file`: its `sha256`, `date` and `verdict`, the
    `device_file_sha256` it belongs to, and in `changed` a note if the file has changed since,
    otherwise "". None if there is none.
    """
    own = certificate_path(device_file, device_file_sha256)
    others = own.parent.glob(f"{device_file.stem}-certificate-*.json")
    known = [own] if own.is_file() else sorted(others, key=lambda path: path.stat().st_mtime_ns)
    return _told(known[-1], device_file_sha256) if known else None


def _told(path: Path, device_file_sha256: str) -> dict[str, Any] | None:
    try:
        content = regular(path, SETTINGS_BYTES).read_bytes()
        said = json.loads(content)
        of = str(said["device"]["file_sha256"])
        told = {"date": str(said["date"]), "verdict": str(said["verdict"])}
    except (ConfigError, OSError, ValueError, LookupError, TypeError):
        return None  # not a certificate: do not rely on it
    return {
        "sha256": hashlib.sha256(content).hexdigest(),
        **told,
        "device_file_sha256": of,
        "changed": "" if of == device_file_sha256 else CHANGED,
    }


# --- provenance -----------------------------------------------------------------------------------

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
    now = datetime.datetime.fromtimestamp(now_ns / NS_PER_S, datetime.UTC)
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


def here() -> dict[str, Any]:
    """Return the software and the processor of this process, for a certificate."""
    software = provenance(commit=commit(), recording=versions(RECORDING_LIBRARIES))
    return {"software": software, "cpu": processor()}


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
