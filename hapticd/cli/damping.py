"""Switch the added electrical damping on or off, or set its level."""

from typing import Annotated

import typer

from hapticd.cli import options
from hapticd.cli.change import change
from hapticd.cli.numbers import number

Value = Annotated[str, typer.Argument(metavar="on|off|LEVEL", help="LEVEL in N s/m; 0 is off.")]


def command(value: Value, instance: options.Instance = options.INSTANCE, as_json: options.Json = False) -> None:
    """Switch the added electrical damping on or off, or set its level (N s/m) and switch it on; live, in every state."""
    asked = value if value in ("on", "off") else number("damping", value, "on, off or a level in N s/m")
    change(instance, as_json, lambda client: client.damping(asked))  # type: ignore[arg-type]
