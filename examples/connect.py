"""Shared by the examples: the connection to a daemon or to the virtual board, and changes that the
guard judges.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import hapticd
from hapticd.client import Client, CommandError, Receipt

PATIENCE_S = 10.0  # while the guard has no verdict
PAUSE_S = 0.1


def arguments(description: str) -> argparse.ArgumentParser:
    """Return the parser with the options of every example."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--instance", default="default", metavar="NAME", help="of the daemon")
    parser.add_argument(
        "--virtual",
        action="store_true",
        help="no daemon: a simulated board on virtual time, whose handle a simulated hand moves",
    )
    return parser


def connected(asked: argparse.Namespace, name: str, strict: bool = False) -> hapticd.Client:
    """Return the requested client."""
    if asked.virtual:
        return hapticd.virtual_board(hand=True, strict=strict, name=name)
    return hapticd.Client(asked.instance, name=name, strict=strict)


def connected_aio(asked: argparse.Namespace, name: str) -> hapticd.AsyncClient:
    """Return the requested client for asyncio."""
    if asked.virtual:
        return hapticd.virtual_board(hand=True, name=name).aio()
    return hapticd.AsyncClient(asked.instance, name=name)


def judged(change: Callable[[], Receipt]) -> Receipt:
    """Make a change, and repeat it while the guard has no verdict in time on a busy computer.

    CommandError if it is refused, or if there is no verdict for PATIENCE_S.
    """
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return change()
        except CommandError as error:
            unknown = error.guard is not None and error.guard.safe is None
            if not unknown or time.monotonic() > deadline_s:
                raise
            time.sleep(PAUSE_S)


def permitted(device: Client, **settings: Any) -> bool:
    """Set these values if the guard permits them; return whether it did."""
    try:
        judged(lambda: device.set(**settings))
    except CommandError as error:
        if error.guard is None or error.guard.safe is None:
            raise  # a refusal for another reason, or no verdict
        return False
    return True
