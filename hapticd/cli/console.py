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
            "--port", metavar="N", min=1, max=65535, help="Else 9873, or any free one when taken."
        ),
    ] = None,
    instance: terminal.Instance = terminal.INSTANCE,
    parent: terminal.Parent = None,
    ready: Annotated[int | None, typer.Option("--ready", hidden=True)] = None,
    as_json: terminal.Json = False,
) -> None:
    """Serve the operators' page on this computer, until Ctrl-C. `hapticd run` starts one by itself.

    The daemon need not run yet. Pages are served to browsers of this computer alone.
    """
    die_with_parent(parent)

    def tell(url: str) -> None:
        if ready is not None:
            os.write(ready, b"1")
            return
        terminal.show({"url": url}, [f"operators' page: {url}   (Ctrl-C here ends it)"], as_json)

    server.serve(instance, port, on_stop, tell)
