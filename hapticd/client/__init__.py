"""What scripts, the command line and every other program use to talk to a running daemon.

    from hapticd.client import Client

    with Client() as device:
        device.set(K=100, B=1, M=0.010)
        device.enable()

A refusal raises CommandError (its `code` and text say why and what to do), silence DaemonDown. `core` holds the
conversation without any I/O, `shell` adds the sockets, `blocks` decodes telemetry, and `fast_stop` is the short way
to a stop. The names below are loaded when they are used, so that `fast_stop` stays fast.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hapticd.client.blocks import Block
    from hapticd.client.client import Client, Receipt
    from hapticd.errors import CommandError, DaemonDown

__all__ = ["Block", "Client", "CommandError", "DaemonDown", "Receipt"]
_HOMES = {
    "Block": "hapticd.client.blocks",
    "Client": "hapticd.client.client",
    "CommandError": "hapticd.errors",
    "DaemonDown": "hapticd.errors",
    "Receipt": "hapticd.client.client",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
