"""Input files: TOML with the line of every key, and checks of a file before it is opened.

TOML (`read`). The names of shipped files are known (`shipped`), and a misspelt name is answered
with the nearest one (`did_you_mean`). Standard library only. tomllib does not report line numbers,
so `read` scans the text again for headers and keys. A `Document` returns with `where(path)` the
file:line of a key or of the nearest enclosing table.

Limitations: a header or key whose quoted name contains the quote itself (the message then refers to
the enclosing table).

Checks (`regular`). A file from the user must be regular and not too large. Opening a pipe waits for
its other end, and a device such as /dev/zero has no end. So a file is checked before it is opened,
only in this module. Links are followed.

Limitations: a file that is replaced between check and opening; only its own user is affected.
"""

import difflib
import hashlib
import io
import re
import stat
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hapticd
from hapticd.core.errors import ConfigError

__all__ = [
    "SAMPLES_BYTES",
    "SETTINGS_BYTES",
    "WAVEFORM_BYTES",
    "Document",
    "did_you_mean",
    "nearest",
    "read",
    "regular",
    "shipped",
]

# --- checks before opening ------------------------------------------------------------------------
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


# --- TOML -----------------------------------------------------------------------------------------
KeyPath = tuple[str | int, ...]  # names of tables and keys, places in lists

_PACKAGE = Path(hapticd.__file__).parent


def shipped(folder: str) -> Path:
    """Return the folder `config`, `firmware_iface` or `systemd`, independent of the working folder.

    It is inside an installed package, or next to the package in a checkout.
    """
    for base in (_PACKAGE / "_data", _PACKAGE.parent):
        if (base / folder).is_dir():
            return base / folder
    raise ConfigError(f"{folder}/ is missing next to {_PACKAGE}; install hapticd again")


_NAME = r"""(?:[\w-]+|"[^"]*"|'[^']*')"""
_DOTTED = rf"{_NAME}(?:\s*\.\s*{_NAME})*"
_HEADER = re.compile(rf"\s*(\[\[?)\s*({_DOTTED})\s*\]")
_KEY = re.compile(rf"\s*({_DOTTED})\s*=")


@dataclass(frozen=True)
class Document:
    """Content of one file, and the line of each part."""

    path: Path
    data: dict[str, Any]
    lines: dict[KeyPath, int]  # line of a table or key, counted from 1
    sha256: str  # of the bytes that were parsed, hex

    def where(self, path: KeyPath) -> str:
        """Return `file:line` of the key, or of the nearest enclosing table."""
        for length in range(len(path), 0, -1):
            if path[:length] in self.lines:
                return f"{self.path}:{self.lines[path[:length]]}"
        return str(self.path)

    def origin(self, path: KeyPath) -> str:
        """Return `file:line` of the key; `default` if the file has none."""
        return "default" if self.value(path) is None else self.where(path)

    def value(self, path: KeyPath) -> Any:
        """Return the value at `path`; None if there is none."""
        found: Any = self.data
        for step in path:
            try:
                found = found[step]
            except (KeyError, IndexError, TypeError):
                return None
        return found


def read(path: Path) -> Document:
    """Parse `path`. ConfigError with file and line if it cannot be read or is not TOML."""
    try:
        content = regular(path, SETTINGS_BYTES).read_bytes()
        text = io.StringIO(content.decode("utf-8"), newline=None).read()
        hashed = hashlib.sha256(content).hexdigest()
        return Document(path, tomllib.loads(text), _lines(text), hashed)
    except OSError as error:
        raise ConfigError(
            f"{path}: {error.strerror}; check the path and its permissions"
        ) from error
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{path}: not UTF-8 text (byte {error.start}); save it as UTF-8"
        ) from error
    except RecursionError as error:
        raise ConfigError(f"{path}: tables or lists are nested too deeply; flatten them") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(_syntax_message(path, str(error))) from error


def _syntax_message(path: Path, message: str) -> str:
    found = re.fullmatch(r"(.*) \(at line (\d+), column (\d+)\)", message, re.DOTALL)
    if not found:
        return f"{path}: not valid TOML: {message}"
    reason, line, column = found.groups()
    return f"{path}:{line}: not valid TOML at column {column}: {reason}"


def _split(dotted: str) -> KeyPath:
    return tuple(name.strip("\"'") for name in re.findall(_NAME, dotted))


def _lines(text: str) -> dict[KeyPath, int]:
    lines: dict[KeyPath, int] = {}
    table: KeyPath = ()
    count: dict[KeyPath, int] = {}
    inside_string = False
    for number, line in enumerate(text.splitlines(), 1):
        if not inside_string:
            if header := _HEADER.match(line):
                table = _split(header[2])
                if header[1] == "[[":
                    count[table] = count.get(table, -1) + 1
                    table = (*table, count[table])
                lines.setdefault(table, number)
            elif key := _KEY.match(line):
                lines.setdefault(table + _split(key[1]), number)
        if (line.count('"""') + line.count("'''")) % 2:
            inside_string = not inside_string
    return lines


def did_you_mean(word: str, known: Sequence[str]) -> str:
    """Return `; did you mean 'x'?` for the nearest of `known`, or an empty text."""
    close = nearest(word, known)
    return f"; did you mean {close!r}?" if close else ""


def nearest(word: str, known: Sequence[str]) -> str:
    """Return the closest match of `word` in `known`; empty if there is none."""
    lower = {name.lower(): name for name in known}
    close = difflib.get_close_matches(word.lower(), lower, 1, 0.6)
    return lower[close[0]] if close else ""
