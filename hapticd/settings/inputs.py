"""Input files from the user: they must be regular and not too large.

Opening a pipe waits for its other end, and a device such as /dev/zero has no end. So a file is
checked before it is opened, only in this module. Links are followed.

Limitations: a file that is replaced between check and opening; only its own user is affected.
"""

import stat
from pathlib import Path

from hapticd.core.errors import ConfigError

__all__ = ["SAMPLES_BYTES", "SETTINGS_BYTES", "WAVEFORM_BYTES", "regular"]

SETTINGS_BYTES = 4 << 20
WAVEFORM_BYTES = 64 << 20
SAMPLES_BYTES = 2 << 30  # of text or arrays that are read completely
MIB = 1 << 20


def regular(path: Path, most_bytes: int | None = None) -> Path:
    """Return `path` if it is a regular file of at most `most_bytes` (None: any size, for files that
    are not read completely). Otherwise ConfigError states its type. The check never waits.
    """
    try:
        found = path.stat()
    except FileNotFoundError as error:
        raise ConfigError(f"{path}: no such file; check the path") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"{path}: {reason}; check the path and its permissions") from error
    if not stat.S_ISREG(found.st_mode):
        raise ConfigError(
            f"{path} is not a regular file (a folder, pipe or device); copy its content into one"
        )
    if most_bytes is not None and found.st_size > most_bytes:
        raise ConfigError(
            f"{path} has {found.st_size / MIB:.0f} MiB, at most {most_bytes // MIB} MiB are read;"
            " name another file"
        )
    return path
