"""Make and try the CURVE keys without which telemetry does not leave this machine."""

from pathlib import Path
from typing import Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.deferred import deferred_imports

with deferred_imports():
    from hapticd.client import listener
    from hapticd.protocol import keys

app = typer.Typer(no_args_is_help=True, help=__doc__)
Folder = Annotated[
    Path, typer.Argument(metavar="FOLDER", help="Folder named by gateway.curve_keys.")
]
Name = Annotated[
    str, typer.Argument(metavar="NAME", help="Name of the machine or person that may listen.")
]


@terminal.verb(app, "server")
def server(folder: Folder, as_json: terminal.Json = False) -> None:
    """The server's pair in a new FOLDER: server.key to hand out, server.key_secret for
    the gateway alone.
    """
    _show(keys.make_keys(folder), folder, as_json)
    if not as_json:
        terminal.talk(
            f"set gateway.curve_keys to {folder}; who may listen: `hapticd keys client {folder}"
            " NAME`"
        )


@terminal.verb(app, "client")
def client(
    folder: Folder,
    name: Name,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            help="Where the client's secret is written; else the current folder.",
        ),
    ] = None,
    as_json: terminal.Json = False,
) -> None:
    """A listener's pair: NAME.key among those whom FOLDER lets in, NAME.key_secret to
    be brought to the listener.
    """
    files = keys.make_client(folder, name, out or Path())
    _show(files, folder, as_json)
    if not as_json:
        terminal.talk(
            f"bring {files[1]} and {folder / 'server.key'} to {name}, and delete the secret here"
        )


@terminal.verb(app, "try")
def try_(
    endpoint: Annotated[
        str,
        typer.Argument(metavar="ENDPOINT", help="As `hapticd status` names it: tcp://RIG:9872."),
    ],
    folder: Annotated[
        Path | None,
        typer.Option(
            "--keys",
            metavar="FOLDER",
            help="With server.key and NAME.key_secret; else without keys.",
        ),
    ] = None,
    as_json: terminal.Json = False,
) -> None:
    """Listen to ENDPOINT for a moment with the keys in FOLDER, and say what comes, or why
    nothing does.
    """
    with listener.Listener(endpoint, folder) as line:
        state = next(line.listen("state"))
    simulated = ", SIMULATED" if state["simulated"] else ""
    said = f"{endpoint}: {state['state']}, {state['rate_hz']:g} Hz{simulated}"
    terminal.show({"endpoint": endpoint, "state": state}, [said], as_json)


def _show(files: tuple[Path, ...], folder: Path, as_json: bool) -> None:
    paths = [str(file) for file in files]
    terminal.show({"folder": str(folder), "files": paths}, paths, as_json)
