"""Files that a machine needs to run hapticd as a service: units, udev rule, user, folders, limits.

The templates are shipped with the package (systemd/). Three placeholders are filled in: the running
interpreter, and vendor and product of the board in the configuration. Only files are written: no
user is created, no unit started.

Limitations: an interpreter in a folder that is hidden from the units (`hidden_interpreter`).
"""

import os
import sys
from pathlib import Path

from hapticd.core.errors import ConfigError
from hapticd.core.params import UsbParams
from hapticd.settings.toml import shipped

__all__ = ["NEXT_STEPS", "hidden_interpreter", "system_files", "write_below"]

PLACES = {
    "hapticd-servo.service": "etc/systemd/system/hapticd-servo.service",
    "hapticd-gateway.service": "etc/systemd/system/hapticd-gateway.service",
    "hapticd.target": "etc/systemd/system/hapticd.target",
    "70-hapticd.rules": "etc/udev/rules.d/70-hapticd.rules",
    "hapticd.sysusers": "etc/sysusers.d/hapticd.conf",
    "hapticd.tmpfiles": "etc/tmpfiles.d/hapticd.conf",
    "95-hapticd.limits": "etc/security/limits.d/95-hapticd.conf",
}
HIDDEN = ("/home/", "/root/", "/run/user/")  # from the units, by ProtectHome
NEXT_STEPS = (
    "systemd-sysusers",
    "systemd-tmpfiles --create",
    "udevadm control --reload && udevadm trigger",
    "systemctl daemon-reload",
    "usermod --append --groups hapticd NAME   # for each operator, who logs in again",
    "systemctl enable --now hapticd.target",
)


def system_files(usb: UsbParams, python: str = sys.executable) -> dict[str, str]:
    """Return the content of each file by its path below the root."""
    words = {
        "@PYTHON@": python,
        "@VENDOR@": f"{usb.vendor_id:04x}",
        "@PRODUCT@": f"{usb.product_id:04x}",
    }
    return {
        place: filled((shipped("systemd") / name).read_text(), words)
        for name, place in PLACES.items()
    }


def filled(template: str, words: dict[str, str]) -> str:
    """Return `template` with each of `words` replaced by its value."""
    for word, meaning in words.items():
        template = template.replace(word, meaning)
    return template


def write_below(root: Path, files: dict[str, str]) -> list[Path]:
    """Write `files` below `root` and return their paths. ConfigError if that is not allowed."""
    written = []
    for place, content in files.items():
        path = root / place
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content)
            path.chmod(0o644)
        except OSError as error:
            raise ConfigError(
                f"{path}: {error.strerror}; write elsewhere with --root DIR, or as root"
            ) from error
        written.append(path)
    return written


def hidden_interpreter(python: str = sys.executable) -> str:
    """Return a warning if the units could not start `python`; otherwise an empty string."""
    real = os.path.realpath(python)  # in a virtual environment it links to the interpreter
    if not real.startswith(HIDDEN):
        return ""
    return (
        f"{real} lies in a folder that the units do not see (ProtectHome=yes); install hapticd into"
        " /opt/hapticd instead"
    )
