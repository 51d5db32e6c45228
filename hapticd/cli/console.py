"""The operators' page, served by hand; `hapticd run` starts it by itself."""

from typing import Annotated

import typer

from hapticd.cli import terminal

Port = Annotated[
    int | None,
    typer.Option(
        "--port", metavar="N", min=1, max=65535, help="Else 9873, or any free one when taken."
    ),
]


def console(
    port: Port = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Serve the operators' page on this computer, until Ctrl-C. `hapticd run` starts one by itself.

    The daemon need not run yet. Pages are served to browsers of this computer alone.
    """
    from hapticd.console.server import serve
    from hapticd.core.process import on_stop

    def tell(url: str) -> None:
        if as_json:
            terminal.data_json({"ok": True, "url": url})
        else:
            terminal.data(f"operators' page: {url}   (Ctrl-C here ends it)")

    serve(instance, port, on_stop, tell)
