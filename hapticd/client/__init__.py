"""Clients of a running daemon, for scripts, the command line and every other program.

    from hapticd.client import Client

    with Client() as device:
        device.set(K=100, B=1, M=0.010)
        device.enable()

    Client         one connection: a method for every command, and the telemetry
    AsyncClient    the same for asyncio: every command is awaited
    Listener       the telemetry of a daemon on another computer, with a key
    ClientLease    exclusive control: `with device.lease("environment"):`
    Receipt        result of an accepted change
    GuardVerdict   verdict of the guard on it: `receipt.guard`, `error.guard`
    GuardWarning   emitted when an unsafe change acts
    step           one change of a sequence: `device.sequence([step("set", K=100), ...])`
    StepReceipt    its result
    Block          consecutive records of a telemetry topic, and the number lost before them
    CommandError   refusal by the daemon: its `code` and text give the reason and the remedy
    DaemonDown     no daemon answers, or the gateway has no servo

These are in `client`, `aio`, `listener`, `sequence` and `blocks`. The package also has `design`
(experiments), `law` (a law of one's own), `commands` and `telemetry` (shared by the clients) and
`formatting` (text for people, and the warning).

`fast_stop` is the short path to a stop, for programs that must not load large modules. The names
above are loaded on first use, so that it stays fast.
"""

from typing import TYPE_CHECKING

from hapticd.core.lazy import lazily

if TYPE_CHECKING:
    from hapticd.client.aio import AsyncClient
    from hapticd.client.blocks import Block
    from hapticd.client.client import Client, ClientLease
    from hapticd.client.listener import Listener
    from hapticd.client.sequence import Step, StepReceipt, step
    from hapticd.core.errors import CommandError, DaemonDown, GuardWarning, SequenceError
    from hapticd.protocol.answers import GuardVerdict, Receipt

__all__ = [
    "AsyncClient",
    "Block",
    "Client",
    "ClientLease",
    "CommandError",
    "DaemonDown",
    "GuardVerdict",
    "GuardWarning",
    "Listener",
    "Receipt",
    "SequenceError",
    "Step",
    "StepReceipt",
    "step",
]
__getattr__, __dir__ = lazily(
    __name__,
    {
        "AsyncClient": "hapticd.client.aio",
        "Block": "hapticd.client.blocks",
        "Client": "hapticd.client.client",
        "ClientLease": "hapticd.client.client",
        "CommandError": "hapticd.core.errors",
        "DaemonDown": "hapticd.core.errors",
        "GuardVerdict": "hapticd.protocol.answers",
        "GuardWarning": "hapticd.core.errors",
        "Listener": "hapticd.client.listener",
        "Receipt": "hapticd.protocol.answers",
        "SequenceError": "hapticd.core.errors",
        "Step": "hapticd.client.sequence",
        "StepReceipt": "hapticd.client.sequence",
        "step": "hapticd.client.sequence",
    },
)
