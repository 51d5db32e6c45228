"""Parsing and receipts shared by verbs that change something.

A word that is no number or names no parameter is a usage error (exit 2) before anybody is asked.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import typer

from hapticd.cli import terminal
from hapticd.errors import CommandError
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
    """Connect to `instance`, `ask` it, and print the receipt; warnings of the guard go to stderr.

    CommandError: refused; by the guard with its verdict in words.
    """
    with connect(instance) as client:
        try:
            receipt = ask(client)
        except CommandError as error:
            found = _found_out(client, error.guard)
            text = "\n".join(_thoughts(str(error), found)) if error.guard else str(error)
            raise CommandError(error.code, text, error.detail, error.guard) from None
        if not as_json:
            terminal.data(receipt_text(receipt))
        lines = _found_out(client, receipt.guard)
    if as_json:
        terminal.data_json({"ok": True, **dataclasses.asdict(receipt)})
    elif receipt.guard and receipt.guard["policy"] != "off" and not receipt.guard["safe"]:
        for line in _thoughts(receipt.guard["text"], lines):
            terminal.talk(terminal.wrapped(f"hapticd: {line}"))


def _thoughts(text: str, allowed: list[str]) -> list[str]:
    """`text` with one thought a line, and what is allowed as soon as it is said what is wrong."""
    wrong, *rest = text.split("; ")
    return [wrong, *allowed, *rest]


def _found_out(client: "Client", verdict: dict[str, Any] | None) -> list[str]:
    """What is known of an unsafe request, with the hand that would shake it, as `verdict` has it
    from then on.
    """
    if not verdict or verdict["safe"] is not False:
        return []
    event = client.hand(verdict)
    verdict["hand"] = event["hand"] if event else None
    return verdict_lines(verdict) + ([event["text"]] if event and event["hand"] else [])


def verdict_lines(verdict: dict[str, Any]) -> list[str]:
    """What a verdict allows, as people read it; nothing where nothing is known."""
    lines = []
    allowed = verdict.get("allowed") or {}
    units = {"K": "N/m", "B": "N s/m", "M": "kg"}
    ranges = [
        f"{name} {ends[0]:.4g} to {ends[1]:.4g} {units[name]}"
        for name, ends in allowed.items()
        if ends and None not in ends
    ]
    if ranges:
        lines.append(f"allowed, each with the others as asked: {', '.join(ranges)}")
    elif allowed:
        lines.append("no K, B or M alone would do, with the others as asked")
    least = verdict.get("least_damping_ns_per_m")
    if least is not None:
        lines.append(f"least level of active damping tried that would do: {least:.4g} N s/m")
    elif allowed and verdict["safe"] is False:
        lines.append("no active damping of this device would do")
    return lines


def receipt_text(receipt: "Receipt") -> str:
    """What became of it, and what will then be in force."""
    if receipt.result == "pressed":
        return "stop pressed; nobody confirmed it, see `hapticd status`"
    stages = (receipt.guard or {}).get("stages", 0)
    result = f"stage 1 of {stages}" if receipt.result == "staged" and stages else receipt.result
    when = f"{result} at tick {receipt.first_tick}"
    if receipt.ramp_end_tick > receipt.first_tick:
        when += f", ramp ends at tick {receipt.ramp_end_tick}"
    shown = _shown(receipt.effective)
    if receipt.result == "staged" and receipt.guard:
        shown += f"; on the way to {_shown(receipt.guard['given'])}"
    return f"{receipt.state}: {when}, revision {receipt.revision}: {shown}{_margin(receipt.guard)}"


def _shown(table: dict[str, Any]) -> str:
    """K, B, M and active damping of parameters in the shape of a `set`."""
    values = dict(parameters(table))
    names = {"K": "K", "B": "B", "M": "M", "damping": "active damping"}
    return ", ".join(f"{names[name]} {values[name]}" for name in names if name in values)


def _margin(verdict: dict[str, Any] | None) -> str:
    """What is to spare, of a display that is known to be safe."""
    if not verdict or not verdict["safe"]:
        return ""
    how = "clamped to what is safe, " if verdict.get("clamped") else ""
    margin = verdict.get("margin_ns_per_m")
    spare = "" if margin is None else f"{margin:.3g} N s/m to spare, "
    return f"; {how}{spare}by {verdict['basis']}"


def parameters(table: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """(dotted name, value with unit) of parameters in the shape of a `set`."""
    for name, value in flat(table):
        place = PLACES.get(name.replace("damping_level", "damping"))
        unit = VALUE_LIMITS[place].unit if place is not None else ""
        yield name, f"{value:.6g}" if unit in ("", "1", "side") else f"{value:.6g} {unit}"
