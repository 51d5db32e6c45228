"""What a machine needs to run hapticd as a service: units, udev rule, user, folders, limits.

The templates are shipped with the package (systemd/). Three words in them are filled in: the
interpreter that runs this, and vendor and product of the board in the configuration. Files are
written and nothing else: no user is made, no unit started.

Limitations: an interpreter in a folder that the units do not see (`hidden_interpreter`).
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
    """Content of each file by its path below the root."""
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
    """`template` with each of `words` replaced by its value."""
    for word, meaning in words.items():
        template = template.replace(word, meaning)
    return template


def write_below(root: Path, files: dict[str, str]) -> list[Path]:
    """Write `files` below `root`; the paths written. ConfigError when that is not allowed."""
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
    """A warning when the units could not start `python`; empty when they can."""
    real = os.path.realpath(python)  # in a virtual environment it is a link to Python itself
    if not real.startswith(HIDDEN):
        return ""
    return (
        f"{real} lies in a folder that the units do not see (ProtectHome=yes); install hapticd into"
        " /opt/hapticd instead"
    )
