"""The certificate of a rig: the one that belongs to a device file, and whether that file has
changed since.

`hapticd rig verify` writes it next to the device file, as rig/NAME-certificate-HASH.json, with the
first digits of the SHA-256 of the device file at that time. A changed file has no certificate of
its own; the newest existing one describes its earlier state. Recordings, run folders and .zwidth
files contain the result of `certificate_of` and `certificate_beside`, not the certificate itself.

Limitations: a device file on another machine than the client (it then has no certificate, without a
message).
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hapticd.core.errors import ConfigError
from hapticd.settings.inputs import SETTINGS_BYTES, regular

__all__ = ["certificate_beside", "certificate_of", "certificate_path"]

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
