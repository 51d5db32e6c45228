"""Force off."""

from hapticd.cli import options
from hapticd.cli.change import change


def command(instance: options.Instance = options.INSTANCE, as_json: options.Json = False) -> None:
    """Force off."""
    change(instance, as_json, lambda client: client.disable())
