"""Options that several verbs share."""

from pathlib import Path
from typing import Annotated

import typer

from hapticd.mailbox.files import DEFAULT_INSTANCE

Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
JsonLines = Annotated[bool, typer.Option("--json", help="One JSON object per line on stdout.")]
Instance = Annotated[str, typer.Option("--instance", metavar="NAME", help="Which daemon.")]
ConfigFile = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="Configuration; else $HAPTICD_CONFIG, ~/.config, /etc, the shipped one."),
]
INSTANCE = DEFAULT_INSTANCE
