"""Where everything is printed: data to stdout, talk to stderr, errors as one line."""

import json
import os
import sys
from typing import Any

from hapticd.errors import CommandError, HapticdError

BOLD, RED, YELLOW, GREEN = "1", "1;31", "1;33", "1;32"


def data(text: str) -> None:
    """A line of data."""
    print(text, flush=True)


def data_json(content: Any) -> None:
    """One object in one line."""
    print(json.dumps(content, default=str), flush=True)


def talk(text: str) -> None:
    """A line for a person who watches."""
    print(text, file=sys.stderr, flush=True)


def hush() -> None:
    """Nobody reads any more: drop everything that this process writes from here on."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2):
        os.dup2(nowhere, descriptor)
    os.close(nowhere)


def coloured(text: str, colour: str, stream: Any = None) -> str:
    """`text` in `colour` if the stream (default stdout) is a terminal and NO_COLOR is not set."""
    plain = os.environ.get("NO_COLOR") or not (stream or sys.stdout).isatty()
    return text if plain else f"\x1b[{colour}m{text}\x1b[0m"


def complain(error: HapticdError, as_json: bool) -> None:
    """What went wrong, in one line for each thing; with --json also as an object on stdout."""
    for line in str(error).splitlines():
        talk(f"{coloured('hapticd:', RED, sys.stderr)} {line}")
    if as_json:
        code = error.code if isinstance(error, CommandError) else type(error).__name__
        detail = error.detail if isinstance(error, CommandError) else None
        data_json({"ok": False, "error": {"code": code, "message": str(error), "detail": detail}})
