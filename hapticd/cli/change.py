"""Parsing and receipts shared by verbs that change something.

A word that is no number or names no parameter is a usage error (exit 2) before anybody is asked.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import typer

from hapticd.cli import terminal
from hapticd.gateway.limits import PLACES, flat
from hapticd.mailbox.layout import VALUE_LIMITS

if TYPE_CHECKING:
    from hapticd.client import Client, Receipt


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
            from hapticd.settings.toml import did_you_mean

            raise typer.BadParameter(
                f"{name!r} is unknown{did_you_mean(name, NAMES)}; see `hapticd set --help`"
            )
        *tables, leaf = name.split(".")
        table = found.setdefault(tables[0], {}) if tables else found
        if leaf in table:
            raise typer.BadParameter(f"{name} is given twice")
        table[leaf] = number(name, text)
    return found


ACTOR = "command line"


def connect(instance: str, timeout_s: float = 2.0) -> "Client":
    """A client of the daemon `instance` that is shown as the command line."""
    from hapticd.client import Client

    return Client(instance, timeout_s=timeout_s, name=ACTOR)


def change(instance: str, as_json: bool, ask: "Callable[[Client], Receipt]") -> None:
    """Connect to `instance`, `ask` it, and print the receipt."""
    with connect(instance) as client:
        receipt = ask(client)
    if as_json:
        terminal.data_json({"ok": True, **dataclasses.asdict(receipt)})
    else:
        terminal.data(receipt_text(receipt))


def receipt_text(receipt: "Receipt") -> str:
    """What became of it, and what will then be in force."""
    if receipt.result == "pressed":
        return "stop pressed; nobody confirmed it, see `hapticd status`"
    when = f"{receipt.result} at tick {receipt.first_tick}"
    if receipt.ramp_end_tick > receipt.first_tick:
        when += f", ramp ends at tick {receipt.ramp_end_tick}"
    values = dict(parameters(receipt.effective))
    names = {"K": "K", "B": "B", "M": "M", "damping": "active damping"}
    shown = ", ".join(f"{names[name]} {values[name]}" for name in names if name in values)
    return f"{receipt.state}: {when}, revision {receipt.revision}: {shown}"


def parameters(table: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """(dotted name, value with unit) of parameters in the shape of a `set`."""
    for name, value in flat(table):
        place = PLACES.get(name.replace("damping_level", "damping"))
        unit = VALUE_LIMITS[place].unit if place is not None else ""
        yield name, f"{value:.6g}" if unit in ("", "1", "side") else f"{value:.6g} {unit}"
