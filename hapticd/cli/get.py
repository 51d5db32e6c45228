"""Show the parameters: what was asked, and what is in force at this tick."""

from hapticd.cli import options, output
from hapticd.cli.change import connect, parameters


def command(instance: options.Instance = options.INSTANCE, as_json: options.Json = False) -> None:
    """Show the parameters that were asked for (ramps at their ends); with --json also what is in force at this tick."""
    with connect(instance) as client:
        found = client.get()
    if as_json:
        output.data_json(found)
        return
    for name, value in parameters(found["parameters"]):
        output.data(f"{name} = {value}")
