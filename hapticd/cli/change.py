"""What the verbs that change something share: ask the daemon, then show its receipt."""

import dataclasses
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from hapticd.cli import output
from hapticd.gateway.limits import PLACES, flat
from hapticd.mailbox.layout import VALUE_LIMITS

if TYPE_CHECKING:
    from hapticd.client import Client, Receipt

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
        output.data_json({"ok": True, **dataclasses.asdict(receipt)})
    else:
        output.data(receipt_text(receipt))


def receipt_text(receipt: "Receipt") -> str:
    """What became of it, and what will then be in force."""
    if receipt.result == "pressed":
        return "stop pressed; nobody confirmed it, see `hapticd status`"
    when = f"{receipt.result} at tick {receipt.first_tick}"
    if receipt.ramp_end_tick > receipt.first_tick:
        when += f", ramp ends at tick {receipt.ramp_end_tick}"
    values = dict(parameters(receipt.effective))
    shown = ", ".join(f"{name} {values[name]}" for name in ("K", "B", "M", "damping") if name in values)
    return f"{receipt.state}: {when}, revision {receipt.revision}: {shown}"


def parameters(table: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """(dotted name, value with unit) of parameters in the shape of a `set`."""
    for name, value in flat(table):
        place = PLACES.get(name.replace("damping_level", "damping"))
        unit = VALUE_LIMITS[place][2] if place is not None else ""
        yield name, f"{value:.6g}" if unit in ("", "1", "side") else f"{value:.6g} {unit}"
