"""The command line, verb by verb."""

from collections.abc import Iterator
from typing import Any

import typer.main

from hapticd.cli.app import command_line
from pages.markdown import table


def commands_page() -> str:
    """Return every verb with its options."""
    root = typer.main.get_command(command_line())
    parts = [
        "# Commands\n",
        f"{root.help}\n",
        *(_verb(name, command) for name, command in _verbs(root, "hapticd")),
    ]
    return "\n".join(parts)


def _verbs(group: Any, prefix: str) -> Iterator[tuple[str, Any]]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from _verbs(command, f"{prefix} {name}")
        else:
            yield f"{prefix} {name}", command


def _verb(name: str, command: Any) -> str:
    rows = [_parameter(parameter) for parameter in command.params if parameter.name != "help"]
    usage = " ".join(
        _metavar(parameter)
        for parameter in command.params
        if parameter.param_type_name == "argument"
    )
    head = f"## `{name}`\n\n    {name} {'[OPTIONS] ' if rows else ''}{usage}\n\n{command.help}\n"
    return f"{head}\n{table(('option', 'meaning'), rows)}" if rows else head


def _parameter(parameter: Any) -> tuple[str, str]:
    value = "" if getattr(parameter, "is_flag", False) else _metavar(parameter)
    names = (
        value
        if parameter.param_type_name == "argument"
        else f"{', '.join(parameter.opts)} {value}".strip()
    )
    return f"`{names}`", parameter.help or ""


def _metavar(parameter: Any) -> str:
    return str(parameter.metavar or parameter.name.upper())
