"""Stop: force off, latched until reset. `hapticd.__main__` takes the same way without loading this."""

import typer

from hapticd.cli import options


def command(instance: options.Instance = options.INSTANCE, as_json: options.Json = False) -> None:
    """Stop: force to 0 at once, latched until `hapticd reset`. Anyone may, at any time; never refused."""
    from hapticd.client.fast_stop import main

    raise typer.Exit(main(instance, as_json))
