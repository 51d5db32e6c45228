"""Files that travel with the package, found by name from any working folder, installed or in a checkout."""

from pathlib import Path

import hapticd
from hapticd.errors import ConfigError

_PACKAGE = Path(hapticd.__file__).parent


def shipped(folder: str) -> Path:
    """`config`, `firmware_iface` or `systemd`: inside an installed package, else beside it in the checkout."""
    for base in (_PACKAGE / "_data", _PACKAGE.parent):
        if (base / folder).is_dir():
            return base / folder
    raise ConfigError(f"{folder}/ did not travel with {_PACKAGE}; install hapticd again")
