"""`hapticd help VERB`, for people who do not think of `--help` first."""

from typing import Annotated

import typer


def explain(
    verb: Annotated[
        list[str] | None,
        typer.Argument(metavar="[VERB [SUBVERB]]", help="For example `set`, or `rec export`."),
    ] = None,
) -> None:
    """Explain a verb, as its --help does; without a VERB list all of them."""
    from hapticd.cli.app import command_line

    words = verb or []
    command_line(*words[:1])(args=[*words, "--help"], prog_name="hapticd", standalone_mode=False)
