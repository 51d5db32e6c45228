"""Leave a stop or fault for disabled, once its cause is gone. Never enables."""

from hapticd.cli import options
from hapticd.cli.change import change


def command(instance: options.Instance = options.INSTANCE, as_json: options.Json = False) -> None:
    """Leave a stop or fault for disabled, once its cause is gone. Never enables."""
    change(instance, as_json, lambda client: client.reset())
