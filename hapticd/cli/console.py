"""The operators' page, started manually; `hapticd run` starts it by itself.

`--parent PID` is the supervisor with which it ends. With `--ready FD`, a byte is written to that
descriptor once the page is served.
"""

import os
from typing import Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.deferred import deferred_imports
from hapticd.core.process import die_with_parent, on_stop

with deferred_imports():
    from hapticd.console import server


def console(
    port: Annotated[
        int | None,
        typer.Option(
            "--port",
            metavar="N",
            min=1,
            max=65535,
            help="Port (default: 9873, or a free one if it is in use).",
        ),
    ] = None,
    instance: terminal.Instance = terminal.INSTANCE,
    parent: terminal.Parent = None,
    ready: Annotated[int | None, typer.Option("--ready", hidden=True)] = None,
    as_json: terminal.Json = False,
) -> None:
    """Serve the operators' page on this computer, until Ctrl-C. `hapticd run` serves one too.

    The daemon need not be running. Only browsers on this computer can open the page.
    """
    die_with_parent(parent)

    def tell(url: str) -> None:
        if ready is not None:
            os.write(ready, b"1")
            return
        terminal.show({"url": url}, [f"operators' page: {url}   (Ctrl-C here ends it)"], as_json)

    server.serve(instance, port, on_stop, tell)
