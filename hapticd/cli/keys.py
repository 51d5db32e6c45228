"""Make and try the CURVE keys without which telemetry does not leave this machine."""

from pathlib import Path
from typing import Annotated

import typer

from hapticd.cli import terminal

app = typer.Typer(no_args_is_help=True, help=__doc__)
Folder = Annotated[
    Path, typer.Argument(metavar="FOLDER", help="Folder named by gateway.curve_keys.")
]
Name = Annotated[
    str, typer.Argument(metavar="NAME", help="Name of the machine or person that may listen.")
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        metavar="DIR",
        help="Where the client's secret is written; else the current folder.",
    ),
]

Endpoint = Annotated[
    str, typer.Argument(metavar="ENDPOINT", help="As `hapticd status` names it: tcp://RIG:9872.")
]
Keys = Annotated[
    Path | None,
    typer.Option(
        "--keys", metavar="FOLDER", help="With server.key and NAME.key_secret; else without keys."
    ),
]


@terminal.verb(app, "server")
def server(folder: Folder, as_json: terminal.Json = False) -> None:
    """The server's pair in a new FOLDER: server.key to hand out, server.key_secret for
    the gateway alone.
    """
    from hapticd.protocol.keys import make_keys

    files = make_keys(folder)
    if as_json:
        _told(files, folder)
        return
    _told(files, None)
    terminal.talk(
        f"set gateway.curve_keys to {folder}; who may listen: `hapticd keys client {folder} NAME`"
    )


@terminal.verb(app, "client")
def client(folder: Folder, name: Name, out: Out = None, as_json: terminal.Json = False) -> None:
    """A listener's pair: NAME.key among those whom FOLDER lets in, NAME.key_secret to
    be brought to the listener.
    """
    from hapticd.protocol.keys import make_client

    files = make_client(folder, name, out or Path())
    if as_json:
        _told(files, folder)
        return
    _told(files, None)
    brought = f"{files[1]} and {folder / 'server.key'}"
    terminal.talk(f"bring {brought} to {name}, and delete the secret here")


@terminal.verb(app, "try")
def try_(endpoint: Endpoint, keys: Keys = None, as_json: terminal.Json = False) -> None:
    """Listen to ENDPOINT for a moment with the keys in FOLDER, and say what comes, or why
    nothing does.
    """
    from hapticd.client import Listener

    with Listener(endpoint, keys) as line:
        state = next(line.listen("state"))
    if as_json:
        terminal.data_json({"ok": True, "endpoint": endpoint, "state": state})
        return
    simulated = ", SIMULATED" if state["simulated"] else ""
    terminal.data(f"{endpoint}: {state['state']}, {state['rate_hz']:g} Hz{simulated}")


def _told(files: tuple[Path, ...], folder: Path | None) -> None:
    if folder is not None:
        terminal.data_json(
            {"ok": True, "folder": str(folder), "files": [str(file) for file in files]}
        )
        return
    for file in files:
        terminal.data(str(file))
