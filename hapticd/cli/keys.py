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
Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="Key folder (gateway.curve_keys).")]
Name = Annotated[
    str, typer.Argument(metavar="NAME", help="Name of the listening machine or person.")
]


@terminal.verb(app, "server")
def server(folder: Folder, as_json: terminal.Json = False) -> None:
    """Create the server's key pair in a new FOLDER: server.key to distribute, and
    server.key_secret for the gateway alone.
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
            help="Folder for the client's secret key (default: the current folder).",
        ),
    ] = None,
    as_json: terminal.Json = False,
) -> None:
    """Create a listener's key pair: NAME.key in FOLDER admits it, and NAME.key_secret goes to the
    listener.
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
        typer.Argument(
            metavar="ENDPOINT",
            help="Telemetry endpoint, as `hapticd status` shows it: tcp://RIG:9872.",
        ),
    ],
    folder: Annotated[
        Path | None,
        typer.Option(
            "--keys",
            metavar="FOLDER",
            help="Folder with server.key and NAME.key_secret (default: no keys).",
        ),
    ] = None,
    as_json: terminal.Json = False,
) -> None:
    """Listen to ENDPOINT for a moment with the keys in FOLDER. Show what arrives, or why nothing
    does.
    """
    with listener.Listener(endpoint, folder) as line:
        state = next(line.listen("state"))
    simulated = ", SIMULATED" if state["simulated"] else ""
    said = f"{endpoint}: {state['state']}, {state['rate_hz']:g} Hz{simulated}"
    terminal.show({"endpoint": endpoint, "state": state}, [said], as_json)


def _show(files: tuple[Path, ...], folder: Path, as_json: bool) -> None:
    paths = [str(file) for file in files]
    terminal.show({"folder": str(folder), "files": paths}, paths, as_json)
