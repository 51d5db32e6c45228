"""Force on, with a gain ramp; refused while stopped or faulted."""

from hapticd.cli import options
from hapticd.cli.change import change


def command(instance: options.Instance = options.INSTANCE, as_json: options.Json = False) -> None:
    """Force on, with a gain ramp; refused while stopped or faulted."""
    change(instance, as_json, lambda client: client.enable())
