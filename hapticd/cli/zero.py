"""Make the present position x = 0; only while disabled."""

from hapticd.cli import options
from hapticd.cli.change import change


def command(instance: options.Instance = options.INSTANCE, as_json: options.Json = False) -> None:
    """Make the present position x = 0; only while disabled."""
    change(instance, as_json, lambda client: client.zero())
