"""Libraries that an extra brings, loaded when they are used."""

from importlib import import_module
from typing import Any

from hapticd.errors import HapticdError


def needed(module: str, extra: str) -> Any:
    """The module. HapticdError that names the extra when it is not installed."""
    try:
        return import_module(module)
    except ImportError as error:
        raise HapticdError(f"this needs {module.partition('.')[0]} ({error}); install hapticd[{extra}]") from error
