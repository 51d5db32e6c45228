"""Numbers and NAME=VALUE from the command line; a mistake is a usage error (exit 2)."""

from collections.abc import Sequence
from typing import Any

import typer

from hapticd.gateway.limits import PLACES
from hapticd.settings.meant import did_you_mean

NAMES = tuple(name for name in PLACES if name != "ramp_s")


def number(name: str, text: str, expected: str = "a number") -> int | float:
    """`text` as int or float."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    raise typer.BadParameter(f"{name}: {text!r} is not {expected}")


def changes(words: Sequence[str]) -> dict[str, Any]:
    """K=100 wall.side=1 -> {"K": 100, "wall": {"side": 1}}, the arguments of Client.set."""
    found: dict[str, Any] = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not equals:
            raise typer.BadParameter(f"{word!r}: write NAME=VALUE, for example K=100")
        if name not in NAMES:
            raise typer.BadParameter(f"{name!r} is unknown{did_you_mean(name, NAMES)}; see `hapticd set --help`")
        *tables, leaf = name.split(".")
        table = found.setdefault(tables[0], {}) if tables else found
        if leaf in table:
            raise typer.BadParameter(f"{name} is given twice")
        table[leaf] = number(name, text)
    return found
